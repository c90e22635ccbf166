"""Case files that must be refused, each with the words its message must hold; shared by the tests of both edges."""

import copy
import datetime
import math
import sys

REMOVED = object()

VALID = {
    "title": "Two kinks",
    "erosion": {"law": "rational"},
    "profile": {"kind": "kinks", "positions": [-3.0, -2.0], "amplitudes": [0.4, 1.2]},
    "domain": {"left": -6.0, "cells": 60},
    "time": {"end": 1.0, "snapshots": 3},
    "solver": {"method": "godunov", "cfl": 0.9},
    "output": {"vtk": False, "plots": False},
}
LAWS = {
    "rational": {},
    "log": {},
    "power": {"m": 2.0},
    "expression": {"expression": "sqrt(1+q) - 1/sqrt(1+q)"},
    "python": {"file": "user.py", "function": "f"},
}
PROFILES = {
    "kinks": {"positions": [-3.0, -2.0], "amplitudes": [0.4, 1.2]},
    "bumps": {"amplitudes": [0.5], "centres": [-3.0], "widths": [0.5]},
    "steps": {"edges": [-3.0, -2.0, -1.0], "values": [0.5, -0.25]},
    "points": {"x": [-3.0, -2.0, -2.0, -1.0], "q": [0.0, 0.5, -0.25, 1.0]},
    "steady": {"flux": 0.3, "kink": -2.0},
    "survey": {"file": "survey.csv", "critical_slope": 0.5, "length": 2.0, "repair": "isotonic"},
    "python": {"file": "user.py", "function": "u"},
}
COEFFICIENTS = {
    "expression": {"expression": "exp(-0.2*x)/(1 + t)"},
    "python": {"file": "user.py", "function": "k"},
}
FILES = {  # what the tables above name
    "user.py": "import math\n\n\ndef supply(t):\n    return 0.1 + 0.05*math.sin(t)\n\n\n"
    "def f(q):\n    return math.log(1 + q)\n\n\n"
    "def u(x):\n    return x + 0.5 * math.erfc(-2 * (x + 3))\n\n\n"
    "def k(t, x):\n    return 1 + t - x\n",
    "survey.csv": "x,height\n0,0\n1,0.25\n2,0.2\n4,3\n",
}


def changed(changes):
    """VALID with other values at dotted keys; a whole section may be replaced."""
    content = copy.deepcopy(VALID)
    for dotted, value in changes.items():
        *sections, key = dotted.split(".")
        table = content
        for section in sections:
            table = table[section]
        if value is REMOVED:
            del table[key]
        else:
            table[key] = copy.deepcopy(value)
    return content


def with_files(folder):
    """The folder, with the files that LAWS and PROFILES name."""
    for name, text in FILES.items():
        (folder / name).write_text(text)
    return folder


NUMBER, WHOLE, TEXT, LIST, SWITCH = (
    "a finite number",
    "a whole number",
    "a string",
    "a list of finite numbers",
    "true or",
)
POSITIVE = "a positive number"
NOT = {
    NUMBER: ["1", True, [1.0], {}, math.nan, math.inf, -math.inf, datetime.date(2024, 5, 1)],
    POSITIVE: ["1", True, [1.0], {}, math.nan, math.inf, 0.0, 0, -1.0],
    WHOLE: ["1", True, [1], {}, 3.0, math.nan],
    TEXT: [1, True, ["a"], {}],
    LIST: [1.0, "1", {}, ["1"], [[1.0]], [True], [math.nan], [0.0, math.inf]],
    SWITCH: [1, "true", [], {}],
}
KEYS = [  # (section, its table, key, what it must be, whether it may be left out)
    ("erosion", VALID["erosion"], "law", TEXT, False),
    ("profile", VALID["profile"], "kind", TEXT, False),
    ("domain", VALID["domain"], "left", NUMBER, True),
    ("domain", VALID["domain"], "cells", WHOLE, False),
    ("time", VALID["time"], "end", NUMBER, False),
    ("solver", VALID["solver"], "method", TEXT, True),
    ("solver", VALID["solver"], "cfl", POSITIVE, True),
    ("solver", VALID["solver"], "refresh", POSITIVE, True),
    ("solver", {"method": "auto"}, "tolerance", POSITIVE, True),
    ("output", VALID["output"], "vtk", SWITCH, True),
    ("output", VALID["output"], "plots", SWITCH, True),
    ("erosion", {"law": "power", "m": 2.0}, "m", POSITIVE, False),
    ("erosion", {"law": "expression"} | LAWS["expression"], "expression", TEXT, False),
    ("erosion", {"law": "python"} | LAWS["python"], "file", TEXT, False),
    ("erosion", {"law": "python"} | LAWS["python"], "function", TEXT, False),
    ("coefficient", {"kind": "expression"} | COEFFICIENTS["expression"], "kind", TEXT, False),
    ("coefficient", {"kind": "expression"} | COEFFICIENTS["expression"], "expression", TEXT, False),
    ("coefficient", {"kind": "python"} | COEFFICIENTS["python"], "file", TEXT, False),
    ("coefficient", {"kind": "python"} | COEFFICIENTS["python"], "function", TEXT, False),
    ("coefficient", {"kind": "run", "result": "nowhere"}, "result", TEXT, False),
]
for _kind, _table in PROFILES.items():
    for _key, _value in _table.items():
        _what = LIST if isinstance(_value, list) else TEXT if isinstance(_value, str) else NUMBER
        _what = POSITIVE if _key in ("critical_slope", "length") else _what
        KEYS.append(("profile", {"kind": _kind} | _table, _key, _what, _key in ("kink", "repair")))

# id -> (changes to VALID, the section the message must name, the words it must hold)
BAD = {}
_FIRST = {}  # kind of a mistake -> the first id
for _section, _table, _key, _what, _optional in KEYS:
    _name = f"{_section}.{_table.get('law', _table.get('kind', ''))}.{_key}".replace("..", ".")
    if not _optional:
        _rest = {k: v for k, v in _table.items() if k != _key}
        _FIRST.setdefault("missing", f"{_name} missing")
        _needed = "a file of points" if _name == "profile.survey.file" else _what
        BAD[f"{_name} missing"] = ({_section: _rest}, _section, [f"{_key} is missing; it must be {_needed}"])
    for _value in NOT[_what]:
        _words = [f"{_key} = {_value!r} must be {_what}"]
        _FIRST.setdefault((_what, "a number" if isinstance(_value, float) else type(_value)), f"{_name} = {_value!r}")
        BAD[f"{_name} = {_value!r}"] = ({_section: _table | {_key: _value}}, _section, _words)
    _FIRST.setdefault("misspelt", f"{_name}s")
    _wrong = {_section: _table | {f"{_key}s": 1}}
    BAD[f"{_name}s"] = (_wrong, _section, [f"{_key}s is not a known key; did you mean {_key!r}?", "(allowed: "])
for _section in ("erosion", "profile", "domain", "time", "solver", "output", "expect"):
    for _value in (3, "text", [1], True):
        _FIRST.setdefault("no table", f"{_section} = {_value!r}")
        BAD[f"{_section} = {_value!r}"] = ({_section: _value}, "", [f"{_section} = {_value!r} must be a table"])
for _section, _first in (("erosion", "law"), ("profile", "kind"), ("domain", "cells"), ("time", "end")):
    _FIRST.setdefault("no section", f"no {_section}")
    BAD[f"no {_section}"] = ({_section: REMOVED}, _section, [f"{_first} is missing"])
BAD |= {
    "title": ({"title": 3}, "", ["title = 3 must be a string"]),
    "a law near another": ({"erosion.law": "Ratinal"}, "erosion", ["did you mean 'rational'? allowed are 'rational',"]),
    "a kind near another": (
        {"profile.kind": "kink"},
        "profile",
        ["did you mean 'kinks'? allowed are 'kinks',"],
    ),
    "a number in quotes": ({"time.end": "1.5"}, "time", ["end = '1.5' must be a finite number (without quotes)"]),
    "no law": ({"erosion": {"expression": "q"}}, "erosion", ["it must be a string, one of 'rational', 'log'"]),
    "wrong sign": (
        {"erosion": {"law": "expression", "expression": "-q/(1+q)"}},
        "erosion",
        ["f' > 0 fails at q = ", "its sign is wrong, because f must be positive for q > 0"],
    ),
    "convex": (
        {"erosion": {"law": "expression", "expression": "exp(q) - 1"}},
        "erosion",
        ["f'' < 0 fails at q = 0; f must be concave"],
    ),
    "not 0 at 0": (
        {"erosion": {"law": "expression", "expression": "q/(1+q) + 0.1"}},
        "erosion",
        ["f(0) = 0 fails at q = 0, where f = 0.1; at the neutral slope there is no erosion and no deposition"],
    ),
    "a power of another language": (
        {"erosion": {"law": "expression", "expression": "q^2"}},
        "erosion",
        ["contains '^' (a power is written **); allowed are"],
    ),
    "a large letter": (
        {"erosion": {"law": "expression", "expression": "Q/(1+Q)"}},
        "erosion",
        ["contains 'Q'; did you mean 'q'? allowed are"],
    ),
    "two scenes at once": (
        {
            "erosion": {"law": "expression", "expression": "q + q/(1+q)", "growth": "linear"},
            "coefficient": {"kind": "expression", "expression": "exp(x)"},
        },
        "coefficient",
        ["a coefficient and a law with growth = 'linear' cannot be combined"],
    ),
    "unknown section": (
        {"erosoin": {}},
        "",
        ["erosoin is not a known key; did you mean 'erosion'?", "(allowed: title,"],
    ),
    "unknown top key": ({"zzz": 1}, "", ["zzz is not a known key (allowed: title, erosion, layer, profile,"]),
    "unknown law": (
        {"erosion.law": "linear"},
        "erosion",
        ["law = 'linear' is not known; allowed are 'rational', 'log'"],
    ),
    "unknown kind": (
        {"profile.kind": "hills"},
        "profile",
        ["kind = 'hills' is not known; allowed are 'kinks', 'bumps'"],
    ),
    "key of another law": ({"erosion.m": 2.0}, "erosion", ["m is not a known key (allowed: law)"]),
    "key of another kind": ({"profile.flux": 0.3}, "profile", ["flux is not a known key", "amplitudes"]),
    "left = 0": ({"domain.left": 0}, "domain", ["left = 0.0 must be a negative number"]),
    "left > 0": ({"domain.left": 2.5}, "domain", ["left = 2.5 must be a negative number, because the crest"]),
    "right on the half line": (
        {"domain.right": 2.5},
        "domain",
        ["right = 2.5 needs line = 'whole'", "the crest is at x"],
    ),
    "a needed key misspelt": ({"time": {"ed": 1.0}}, "time", ["end is missing ('ed' is not a known key); it must be"]),
    "law misspelt": ({"erosion": {"lav": "log"}}, "erosion", ["law is missing ('lav' is not a known key)"]),
    "no right on the line": ({"domain.line": "whole"}, "domain", ["right is missing; it must be a finite number"]),
    "unknown line": ({"domain.line": "double"}, "domain", ["line = 'double' is not known", "'half', 'whole'"]),
    "right of left": (
        {"domain.line": "whole", "domain.left": 2.0, "domain.right": 1.5},
        "domain",
        ["left = 2.0 must be less than right = 1.5"],
    ),
    "past the window": (
        {"domain.line": "whole", "domain.right": -2.5},
        "profile",
        ["positions[1] = -2 lies past right = -2.5, where the window ends"],
    ),
    "a bump past the window": (
        {
            "domain.line": "whole",
            "domain.right": -2.0,
            "profile": {"kind": "bumps", "amplitudes": [0.5], "centres": [-3.0], "widths": [0.5]},
        },
        "profile",
        ["the slope is not neutral from right = -2 on", "increase right"],
    ),
    "a steady slope on the line": (
        {"domain.line": "whole", "domain.right": 1.0, "profile": {"kind": "steady", "flux": 0.3, "kink": -2.0}},
        "profile",
        ["kind = 'steady' is for the half line only"],
    ),
    "no supply_flux": ({"layer": {"supply_flux": -0.5}}, "layer", ["supply_flux = -0.5 must be a number, 0 or more"]),
    "a supply that runs out": (
        {"layer": {"supply_flux": "0.5 - t"}},
        "layer",
        ["supply_flux = -0.5 at t = 1 is not a positive number"],
    ),
    "a layer under another law": (
        {"layer": {"supply_flux": 0.5}, "erosion.law": "log"},
        "layer",
        ["supply_flux = 0.5 needs the law 'rational', not 'log'"],
    ),
    "a layer on the line": (
        {"layer": {"supply_flux": 0.5}, "domain.line": "whole", "domain.right": 1.0},
        "domain",
        ["supply_flux = 0.5 needs line = 'half'"],
    ),
    "no cells": ({"domain.cells": 0}, "domain", ["cells = 0 must be a whole number, 4 or more"]),
    "negative cells": ({"domain.cells": -5}, "domain", ["cells = -5 must be a whole number, 4 or more"]),
    "too many cells": ({"domain.cells": 10**15}, "domain", [f"cells = {10**15} with 3 snapshots needs", "cells fit"]),
    "far too many cells": ({"domain.cells": 10**400}, "domain", ["cells = 1000", "GiB of memory", "cells fit"]),
    "end < 0": ({"time.end": -1.0}, "time", ["end = -1.0 must be a number, 0 or more"]),
    "end too small": ({"time.end": 1e-310}, "time", ["end = 1e-310 must be a number, 0 or more, from 1e-300"]),
    "no snapshots": ({"time.snapshots": 0}, "time", ["snapshots = 0 must be 1 or more, or a list of times"]),
    "negative snapshots": ({"time.snapshots": -1}, "time", ["snapshots = -1 must be 1 or more"]),
    "empty snapshots": ({"time.snapshots": []}, "time", ["snapshots = [] must be a count or a list of times"]),
    "snapshots past end": ({"time.snapshots": [0.0, 1.5]}, "time", ["snapshots holds 1.5", "between 0 and end = 1"]),
    "snapshots before 0": ({"time.snapshots": [-0.5, 1.0]}, "time", ["snapshots holds -0.5", "between 0 and end = 1"]),
    "unsorted snapshots": ({"time.snapshots": [0.5, 0.25]}, "time", ["snapshots = [0.5, 0.25] must increase"]),
    "repeated snapshots": ({"time.snapshots": [0.5, 0.5]}, "time", ["snapshots = [0.5, 0.5] must increase"]),
    "too many snapshots": ({"time.snapshots": 10**15}, "domain", [f"with {10**15} snapshots", "use fewer snapshots"]),
    "far too many snapshots": ({"time.snapshots": 10**400}, "domain", ["snapshots needs", "use fewer snapshots"]),
    "past the domain": (
        {"domain.left": -2.5},
        "profile",
        ["reaches left to x = -3", "left = -2.5", "must be at most -3"],
    ),
    "falling kinks": ({"profile.amplitudes": [0.4, 0.1]}, "profile", ["amplitudes[1] = 0.1 must exceed q = 0.14"]),
    "lengths differ": ({"profile.amplitudes": [0.4]}, "profile", ["amplitudes has 1 entries and positions has 2"]),
    "past the top": ({"profile.positions": [-3.0, 1.0]}, "profile", ["positions[1] = 1 lies past the crest"]),
    "too large m": (
        {"erosion": {"law": "power", "m": 1e308}},
        "erosion",
        ["m = 1e+308 must be a positive number, at most"],
    ),
    "overflow": (
        {"erosion": {"law": "power", "m": 2.0}, "profile.amplitudes": [0.4, 1e308]},
        "profile",
        ["amplitudes[1] = 1e+308 must be a finite number, at most 1e8 in size"],
    ),
    "overflow of a mean": (
        {"profile": {"kind": "steps", "edges": [-1.0, -0.5], "values": [sys.float_info.max]}},
        "profile",
        ["values[0] = 1.79769e+308 must be a finite number, at most 1e8 in size"],
    ),
    "inadmissible": (
        {"erosion": {"law": "expression", "expression": "q"}},
        "erosion",
        ["not an erosion function", "at q ="],
    ),
    "attack": (
        {"erosion": {"law": "expression", "expression": "__import__('os').system('touch pwned')"}},
        "erosion",
        ["expression = ", "__import__", "allowed are numbers, q, + - * / **"],
    ),
    "huge power": ({"erosion": {"law": "expression", "expression": "9**9**9**9*q"}}, "erosion", ["f = nan"]),
    "coefficient that is negative": (
        {"coefficient": {"kind": "expression", "expression": "1 + x"}},
        "coefficient",
        ["the coefficient k = -", "at t = 0", "is not a positive number"],
    ),
    "coefficient of q": (
        {"coefficient": {"kind": "expression", "expression": "1 + q"}},
        "coefficient",
        ["expression = '1 + q' contains 'q'; allowed are numbers, t, x, + - * / **"],
    ),
    "coefficient of no run": (
        {"coefficient": {"kind": "run", "result": "nowhere"}},
        "coefficient",
        ["result = 'nowhere' is not a result folder"],
    ),
    "coefficient without function": (
        {"coefficient": {"kind": "python", "file": "user.py", "function": "g"}},
        "coefficient",
        ["function = 'g' is not defined in user.py"],
    ),
    "law without file": (
        {"erosion": {"law": "python", "file": "absent.py", "function": "f"}},
        "erosion",
        ["file = '", "absent.py' does not exist"],
    ),
    "law without function": (
        {"erosion": {"law": "python", "file": "user.py", "function": "g"}},
        "erosion",
        ["function = 'g' is not defined in user.py"],
    ),
    "profile without function": (
        {"profile": {"kind": "python", "file": "user.py", "function": "g"}},
        "profile",
        ["function = 'g' is not defined in user.py"],
    ),
    "no profile of slopes": (
        {"profile": {"kind": "python", "file": "user.py", "function": "f"}},
        "profile",
        ["cannot be evaluated: ValueError"],
    ),
    "no survey": (
        {"profile": {"kind": "survey"} | PROFILES["survey"] | {"file": "absent.csv"}},
        "profile",
        ["absent.csv"],
    ),
    "a survey near another": (
        {"profile": {"kind": "survey"} | PROFILES["survey"] | {"file": "survy.csv"}},
        "profile",
        ["survy.csv' does not exist, or is not a file; did you mean 'survey.csv'?"],
    ),
    "survey is a folder": (
        {"profile": {"kind": "survey"} | PROFILES["survey"] | {"file": "."}},
        "profile",
        ["file = "],
    ),
    "survey without end": (
        {"profile": {"kind": "survey"} | PROFILES["survey"] | {"file": "/dev/zero"}},
        "profile",
        ["file = '/dev/zero' does not exist, or is not a file"],
    ),
    "survey with NUL": ({"profile": {"kind": "survey"} | PROFILES["survey"] | {"file": "a\0"}}, "profile", ["file = "]),
    "survey descends": (
        {"profile": {"kind": "survey", "file": "survey.csv", "critical_slope": 0.5, "length": 2.0}},
        "profile",
        ["survey.csv' does not rise in rows 3-4", "repair = 'isotonic'"],
    ),
    "unknown repair": (
        {"profile": {"kind": "survey"} | PROFILES["survey"] | {"repair": "mend"}},
        "profile",
        ["repair = 'mend' is not known; allowed is 'isotonic'"],
    ),
    "too much flux": (
        {"profile": {"kind": "steady", "flux": 1.0}},
        "profile",
        ["flux = 1 is not a value of the law 'rational'"],
    ),
}
# for the command line: one of each kind that is made above, and those that a command could treat otherwise
ONE_OF_EACH = [
    *_FIRST.values(),
    "title",  # no section
    "wrong sign",  # a law
    "a layer under another law",
    "past the window",  # a profile on the whole line
    "far too many cells",
    "repeated snapshots",
    "attack",
    "huge power",  # numpy could warn
    "overflow of a mean",  # likewise
    "coefficient of no run",
    "no profile of slopes",  # a function of the user that fails
    "a survey near another",
    "survey without end",
    "survey with NUL",
    "survey descends",
]
BAD |= {
    f"snapshots = {value!r}": (
        {"time.snapshots": value},
        "time",
        [f"snapshots = {value!r} must be a whole number or a list"],
    )
    for value in (1.5, "3", True, {}, ["a"], [math.nan], [True])
}

NOT_TOML = {  # id -> (bytes of the file, words)
    "not TOML": (b"[erosion\nlaw = 'rational'\n", ["not valid TOML", "line 1"]),
    "repeated key": (b"title = 'a'\ntitle = 'b'\n", ["not valid TOML"]),
    "not UTF-8": (b"title = '\xff'\n", ["cannot be read", "utf-8"]),
    "text without quotes": (
        b"[erosion]\nlaw = rational\n",
        ["not valid TOML", "which reads 'law = rational'"],
    ),
    "a path of Windows": (
        b'[profile]\nfile = "C:\\data\\mine.csv"\n',
        ["not valid TOML", "; write paths with / or in single quotes"],
    ),
    "UTF-16": ("title = 'a'\n".encode("utf-16"), ["cannot be read: it is not text in UTF-8", "save it as UTF-8"]),
    "NUL": (b"title = 'a\0'\n", ["not valid TOML"]),
    "nested": (b"title = " + b"[" * 20_000, ["not valid TOML"]),
    "thousands of digits": (b"title = " + b"9" * 5000, ["not valid TOML"]),
    "empty": (b"", ["law is missing"]),
    "hexadecimal": (b"title = 0x" + b"f" * 5000, ["title = (too long to be shown) must be a string"]),
    "hexadecimal count": (
        b"time.end = 1.0\nerosion.law = 'log'\nprofile = {kind = 'kinks', positions = [-1], amplitudes = [1]}\n"
        b"domain.left = -6.0\ndomain.cells = 0x" + b"f" * 5000,
        ["[domain] cells = (too long to be shown) must be a whole number"],
    ),
    "dotted": (b"title" + b".a" * 5000 + b" = 1", ["title = (too long to be shown) must be a string"]),
    "line break in a key": (b'"a\\nb" = 1', ["'a\\nb' is not a known key (allowed: title"]),
}
