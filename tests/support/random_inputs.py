"""Random case files, expressions and surveys, most of them bad. Each function takes a `random.Random`."""

import copy
import string

import tomli_w
from bad_cases import LAWS, PROFILES, VALID

from hjprofile.problem.case_files import shipped_cases
from hjprofile.solvers.methods import named

SHIPPED = {name: path.read_text(encoding="utf-8") for name, path in shipped_cases().items()}
NUMBERS = [
    "0", "-0.0", "1", "-1", "3", "0.5", "-0.999999999999", "1e-320", "1e308", "-1e308", "nan", "-inf", "1e999",
    "9" * 400, "0x" + "f" * 4000, "-" + "9" * 5000, "1_0", "2024-05-01", "08:00:00", "0o17", "1e-9", "1e16",
]  # fmt: skip
WORDS = [
    "", "\0", "\n", "\r\n", "\x1b[31m", "\x7f", "\ufeff", "\u202e", "\u2028", "ｑ", "é", "e\u0301", "𝓆", "\U0010ffff",
    "%s", "{0}", "$x_$", "\\", '"', "'", "#", "[", "]]", "=", "....", "a" * 500, "nan", "isotonic", "godunow",
    "user.py", "survey.csv", "absent.csv", ".", "/", "/dev/null", "../..", "f" * 300 + ".py", "f", "u", "q",
    "log(1+q)", "q/(1+q)",
    *LAWS, *PROFILES, *named(),
]  # fmt: skip
VALUES = [
    "[]", "{}", "[[]]", "[nan]", "[1, 'a']", "[[-3.0]]", "[-3.0, -2.0, -1.0]", "{a = 1}", "true", "''", "'\\'",
    '"\\u0000"', '"\\ud800"', '"""\n"""', "[" * 60 + "]" * 60, "[" * 3000, "{a." + "b." * 3000 + "c = 1}",
    "[" + "1," * 2000 + "]",
]  # fmt: skip


def lines_moved(rng, text):
    """A line dropped, doubled, or two in each other's place."""
    lines = text.splitlines(keepends=True) or [""]
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    match rng.randrange(3):
        case 0:
            del lines[i]
        case 1:
            lines.insert(j, lines[i])
        case _:
            lines[i], lines[j] = lines[j], lines[i]
    return "".join(lines)


def value_replaced(rng, text):
    """What stands behind one of the `=` made a strange number, list, table or string."""
    places = [i for i, character in enumerate(text) if character == "="]
    if not places:
        return text
    at = rng.choice(places) + 1
    end = text.find("\n", at)
    new = rng.choice([rng.choice(NUMBERS), rng.choice(VALUES), tomli_w.dumps({"a": rng.choice(WORDS)})[4:-1]])
    return f"{text[:at]} {new}{text[end:] if end >= 0 else ''}"


def number_replaced(rng, text):
    """One of the digits, inside lists too, made a strange number."""
    places = [i for i, character in enumerate(text) if character.isdigit()]
    if not places:
        return text
    at = rng.choice(places)
    return text[:at] + rng.choice(NUMBERS) + text[at + 1 :]


def words_inserted(rng, text):
    at = rng.randint(0, len(text))
    return text[:at] + rng.choice(WORDS + VALUES + NUMBERS) + text[at:]


def cut_short(rng, text):
    return text[: rng.randint(0, len(text))]


def bytes_changed(rng, data):
    """A few bytes made any others, which need not be UTF-8."""
    changed = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        at = rng.randint(0, len(changed))
        changed[at : at + rng.randint(0, 2)] = bytes(rng.randrange(256) for _ in range(rng.randint(0, 2)))
    return bytes(changed)


def broken_text(rng, text):
    """The text after a few of the changes above, as bytes."""
    edits = [lines_moved, value_replaced, number_replaced, words_inserted, cut_short]
    for _ in range(rng.randint(1, 3)):
        text = rng.choice(edits)(rng, text)
    data = text.encode("utf-8")
    return bytes_changed(rng, data) if rng.random() < 0.3 else data


def random_number(rng):
    return rng.choice([
        rng.uniform(-10.0, 10.0), rng.uniform(-1.0, 1.0), float(rng.randint(-5, 5)), rng.randint(-10, 200),
        10.0 ** rng.uniform(-320, 308), -(10.0 ** rng.uniform(-320, 308)), -0.0, float("nan"), float("inf"), 10**400,
    ])  # fmt: skip


def random_value(rng):
    """Anything that TOML can hold."""
    match rng.randrange(7):
        case 0:
            return rng.choice(WORDS)
        case 1:
            return rng.random() < 0.5
        case 2:
            return [random_number(rng) for _ in range(rng.randint(0, 5))]
        case 3:
            return [random_value(rng) for _ in range(rng.randint(0, 2))]
        case 4:
            return {rng.choice(WORDS): random_value(rng)}
        case _:
            return random_number(rng)


def places_on_the_left(rng, count, left=-8.0):
    return sorted(round(rng.uniform(left, 0.0), 3) for _ in range(count))


def random_law(rng):
    law = rng.choice(list(LAWS))
    table = {"law": law} | LAWS[law]
    if law == "power":
        table["m"] = 10.0 ** rng.uniform(-4, 2)
    if law == "expression":
        a, b = round(rng.uniform(0.1, 3.0), 2), round(rng.uniform(0.0, 2.0), 2)
        table["expression"] = rng.choice([f"{a}*log1p(q) + {b}*q/(1+q)", f"{a} - {a}*(1+q)**-{b}", f"q/(1+{a}*q)"])
    return table


def random_profile(rng, least=-0.95, largest=5.0):
    """A profile's table, with numbers that are admissible more often than not."""
    kind = rng.choice(list(PROFILES))
    table = {"kind": kind} | copy.deepcopy(PROFILES[kind])
    n = rng.randint(1, 4)

    def slopes(count):
        return [round(rng.uniform(least, largest) * rng.choice([0.1, 0.3, 1.0]), 4) for _ in range(count)]

    match kind:
        case "kinks":
            table |= {"positions": places_on_the_left(rng, n), "amplitudes": sorted(slopes(n))}
        case "bumps":
            widths = [10.0 ** rng.uniform(-2, 0.3) for _ in range(n)]
            table |= {"amplitudes": slopes(n), "centres": places_on_the_left(rng, n), "widths": widths}
        case "steps":
            table |= {"edges": places_on_the_left(rng, n + 1), "values": slopes(n)}
        case "points":
            x = places_on_the_left(rng, n + 1)
            x = sorted(x + rng.sample(x, rng.randint(0, 1)))
            table |= {"x": x, "q": slopes(len(x))}
        case "steady":
            table["flux"] = 10.0 ** rng.uniform(-3, 0.3)
            table["kink"] = rng.uniform(-5.0, -0.01)
            if rng.random() < 0.3:
                del table["kink"]
        case "survey":
            table |= {"critical_slope": 10.0 ** rng.uniform(-2, 1), "length": 10.0 ** rng.uniform(-1, 2)}
    return table


def random_content(rng):
    """A case, as a table, whose values fit together more often than not."""
    content = copy.deepcopy(VALID) | {"erosion": random_law(rng), "profile": random_profile(rng)}
    content["domain"] = {"left": rng.choice([-6.0, -12.0, -rng.uniform(0.1, 50.0)]), "cells": rng.randint(4, 60)}
    if rng.random() < 0.2:
        content["domain"] |= {"line": "whole", "right": rng.choice([0.0, rng.uniform(-3.0, 6.0)])}
    end = rng.choice([0.0, 1.0, 1e-12, 10.0 ** rng.uniform(-3, 3)])
    times = sorted({round(rng.uniform(0.0, end), 6) for _ in range(rng.randint(1, 4))})
    content["time"] = {"end": end, "snapshots": rng.choice([1, 2, rng.randint(1, 50), times])}
    content["solver"] = {"method": rng.choice(named()), "cfl": rng.choice([0.9, 1.0, rng.uniform(0.01, 5.0)])}
    if rng.random() < 0.1:
        size = 10.0 ** rng.uniform(-4, 1)
        content["layer"] = {"supply_flux": rng.choice([size, f"{size!r}*(1 + 0.9*sin(20*t))"])}
        content["erosion"], content["solver"]["method"] = {"law": "rational"}, "conservative-telescoping"
    if rng.random() < 0.3:
        content["solver"]["tolerance"] = 10.0 ** rng.uniform(-15, 1)
    content["output"] = {"vtk": rng.random() < 0.5, "plots": rng.random() < 0.5}
    return content


def spoilt(rng, content):
    """The content with up to three values removed, replaced or added anywhere, lists included."""
    for _ in range(rng.randint(1, 3)):
        table = content
        while table:
            key = rng.choice(list(table)) if isinstance(table, dict) else rng.randrange(len(table))
            if isinstance(table[key], (dict, list)) and table[key] and rng.random() < 0.8:
                table = table[key]
                continue
            match rng.randrange(5):
                case 0:
                    del table[key]
                case 1 if isinstance(table, dict):
                    table[rng.choice(WORDS)] = random_value(rng)
                case 2 if isinstance(table[key], (int, float)):
                    table[key] = random_number(rng)
                case _:
                    table[key] = random_value(rng)
            break
    return content


def random_case_file(rng):
    """Bytes of a case file: a shipped one with mistakes, or any values at all."""
    match rng.randrange(4):
        case 0:
            return tomli_w.dumps(random_content(rng)).encode()
        case 1:
            return tomli_w.dumps(spoilt(rng, random_content(rng))).encode()
        case 2:
            return broken_text(rng, tomli_w.dumps(random_content(rng)))
        case _:
            return broken_text(rng, rng.choice(list(SHIPPED.values())))


def small_run(rng):
    """A case that few steps on few cells solve, admissible more often than not."""
    content = random_content(rng)
    content["profile"] = random_profile(rng, least=-0.8, largest=3.0)  # the speed f' grows without bound near -1
    content["domain"]["left"] = rng.choice([-12.0, -12.0, -rng.uniform(1.0, 30.0)])
    end = rng.choice([0.0, 1e-300, 1e-12, rng.uniform(0.01, 0.5)])
    content["time"] = {"end": end, "snapshots": rng.choice([1, 3, [end], [0.5 * end, end]])}
    content["solver"] |= {"cfl": rng.choice([0.9, 1.0, rng.uniform(0.3, 5.0)])}
    if content["solver"]["method"] not in ("auto", "characteristics"):
        content["solver"].pop("tolerance", None)
    elif rng.random() < 0.8:
        content["solver"]["tolerance"] = 10.0 ** rng.uniform(-6, -4)
    return content | {"output": {"vtk": False, "plots": False}}


# what is allowed, what Python reads but a law may not hold, and characters that end or nest something
ALLOWED = ["q", "(1+q)", "1", "2.5", "1e9", "1e-300", "1e300", "+", "-", "*", "/", "**", "(", ")", " "]
ALLOWED += [f"{name}(" for name in ("exp", "log", "log1p", "expm1", "sqrt", "sin", "cos")]
FORBIDDEN = [
    "__import__('os').system('touch pwned')", "open('pwned', 'w')", "__class__", ".__bases__", "__builtins__", "eval(",
    "lambda:", "lambda q:", "[q for q in (1,)]", "{q: q}", "(q := 1)", "f'{q}'", "f'{open(\"pwned\", \"w\")}'", "'",
    '"""', "b'q'", "if", "else", "or", "and ", "not ", "is", "in", "for", "await ", "yield ", "print", "np.", "True",
    "None", "...", "1j", "//", "%", "@", "|", "<<", "~", "<", "==", ",", ":", ";", "=", "[", "]", "{", "}", "\\", "#",
    "\n", "\t",
    "\f", "\r", "\0", "\ud800", "\u2028", "\u202e", "ｑ", "𝓁𝑜𝑔(", "_", "0777", "0x1f", "0b1", "1_0", "1__0",
    "9**9**9**9", "1e999",
    "9" * 400, "-" * 300, "(" * 250, "exp(" * 100, "**q" * 100, "+q" * 400, "q." * 200, "\\N{DASH}", "'\\d'",
    "1if", "0xfor",
]  # fmt: skip


def formula(rng, depth):
    """An arithmetic expression that is read without error; seldom a law."""
    if depth == 0:
        return rng.choice(["q", "(1+q)", "1", "0.5", str(round(rng.uniform(0, 9), 2)), "1e300", "1e-300", "0"])
    inner = formula(rng, depth - 1)
    if rng.random() < 0.4:
        return f"{rng.choice(['exp', 'log', 'log1p', 'expm1', 'sqrt', 'sin', 'cos', '-', '+'])}({inner})"
    return f"({inner}{rng.choice(['+', '-', '*', '/', '**'])}{formula(rng, rng.randrange(depth))})"


def law_by_design(rng):
    """Positive multiples of laws, added."""
    laws = ["log1p(q)", "log(1+q)", "q/(1+q)", "(1 - (1+q)**-2)/2", "-expm1(-log1p(q))", "(sqrt(1+q) - 1/sqrt(1+q))"]
    return " + ".join(f"{rng.uniform(0.1, 9.0):.3g}*{rng.choice(laws)}" for _ in range(rng.randint(1, 4)))


def random_expression(rng):
    match rng.randrange(7):
        case 6:
            return law_by_design(rng)
        case 0:
            return "".join(rng.choice(ALLOWED) for _ in range(rng.randint(0, 14)))
        case 1:
            return "".join(rng.choice(ALLOWED + FORBIDDEN) for _ in range(rng.randint(0, 10)))
        case 2:
            alphabet = string.printable + "\0\x1b\x85\xa0é𝓆ｑ\ud800\U0010ffff"
            return "".join(rng.choice(alphabet) for _ in range(rng.randint(0, 60)))
        case 3:
            return formula(rng, rng.randint(0, 6))
        case 4:
            return f"{law_by_design(rng)} + {rng.choice(['1e-9', '0', '1', 'q'])}*q*{formula(rng, rng.randint(0, 4))}"
        case _:
            word = rng.choice(
                ["-", "(", "((q))+", "exp(", "q**", "~", "[", "{", "lambda:", "not ", "q.", "[]", "9**", "(q)"]
            )
            return word * rng.choice([3, 30, 95, 300, 999, 100_000]) + rng.choice(["q", "", ")"])


def random_survey(rng):
    """Bytes of a survey's CSV file, admissible more often than not before it is spoilt."""
    n = rng.choice([0, 1, 2, 3, 5, 10, 40])
    x = [round(rng.uniform(-1e3, 1e3), 2) for _ in range(n)]
    height = [round(rng.uniform(0, 100), 2) for _ in range(n)]
    if rng.random() < 0.8:
        x.sort()
    if rng.random() < 0.6:
        height.sort(reverse=rng.random() < 0.1)
    rows = [[str(a), str(b)] for a, b in zip(x, height, strict=True)]
    for _ in range(rng.choice([0, 0, 1, 2]) if rows else 0):
        row = rng.choice(rows)
        strange = [
            "nan",
            "inf",
            "",
            " ",
            "1,5",
            "1e308",
            "1e-320",
            "-1e308",
            "0x10",
            "1_0",
            "x",
            '"',
            "1" * 400,
            "é",
            "\0",
            "#",
        ]
        match rng.randrange(4):
            case 0:
                row.append(rng.choice(strange))
            case 1:
                row.pop()
            case 2:
                rows.append(list(row))
            case _:
                row[rng.randrange(len(row)) :] = [rng.choice(strange)]
        row or rows.remove(row)
    separator, quote = rng.choice([","] * 6 + [", ", ";", "\t"]), rng.choice(["", "", "", '"', "'"])
    header = rng.choice([["x", "height"]] * 9 + [["X", "Height"], ["height", "x"], ["x", "height", "q"], ["x"], []])
    end = rng.choice(["\n", "\n", "\r\n", "\r", "\n\n", "\n# a comment\n"])
    text = "".join(separator.join(quote + cell + quote for cell in row) + end for row in [header, *rows])
    data = rng.choice(["", "", "\ufeff", "# survey\n"]).encode() + text.encode(rng.choice(["utf-8"] * 9 + ["utf-16"]))
    return bytes_changed(rng, data) if rng.random() < 0.2 else data
