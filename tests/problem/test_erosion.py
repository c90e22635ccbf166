"""Erosion laws against 60-digit arithmetic, and whatever else somebody may hand in as a law."""

import math
import re
import time
from decimal import Decimal, localcontext

import numpy as np
import pytest
from scipy.integrate import quad

from hjprofile.errors import InputError
from hjprofile.problem.erosion import erosion_law, expression, from_file, log, power, rational

M = 2.5


def power_exact(m):
    return lambda q: (1 - (-Decimal(m) * (1 + q).ln()).exp()) / Decimal(m)


EXACT = {  # name -> (law, f in decimal arithmetic, whether f' and f near 0 are found from f by rounding arithmetic)
    "rational": (rational(), lambda q: q / (1 + q), False),
    "log": (log(), lambda q: (1 + q).ln(), False),
    "power": (power(M), power_exact(M), False),
    "power, m = 1e-9": (power(1e-9), power_exact(1e-9), False),
    "cancelling": (expression("1 - 1/(1+q)"), lambda q: q / (1 + q), True),
    "roots": (expression("sqrt(1+q) - 1/sqrt(1+q)"), lambda q: (1 + q).sqrt() - 1 / (1 + q).sqrt(), True),
    "scalar": (erosion_law(lambda q: math.log(1.0 + q)), lambda q: (1 + q).ln(), True),
}
SLOPES = [-0.999, -0.5, -0.051, -0.05, -0.01, -1e-6, -1e-12, 0.0, 1e-12, 1e-6, 0.01, 0.03, 0.05, 0.051, 0.5, 10.0, 1e4]
laws = pytest.mark.parametrize("name", EXACT)
slopes = pytest.mark.parametrize("q", SLOPES)


def difference(g, q):
    """g' by a central difference in 60 digits, good to 30."""
    h = (1 + q) * Decimal("1e-18")
    return (g(q + h) - g(q - h)) / (2 * h)


def exact(g, q):
    """g(q) for a float q, computed in 60 digits; q = 0, where R is 0/0, is approached to 1e-15."""
    with localcontext() as context:
        context.prec = 60
        return float(g(Decimal(q) if q else Decimal("1e-15")))


def R_exact(f):
    return lambda q: q / f(q)


def R_derivative_exact(f):
    return lambda q: difference(R_exact(f), q)


@laws
@slopes
def test_f_and_its_derivative(name, q):
    law, f, rounded = EXACT[name]
    value = exact(f, q) if q else 0.0
    slope = exact(lambda p: difference(f, p), q)
    # closed forms: a few roundings, times the exponent m + 1 and |ln(1+q)| < 10 in a power
    assert law.derivative(np.array(q)) == pytest.approx(
        slope,
        rel=1e-14,
        # by differences with h = (1+q)/100: rounding of f, and of q where 1+q is small, divided by h
        abs=1e-13 * (slope + abs(value) / (1 + q)) / min(1.0, 1 + q) if rounded else 0.0,
    )
    # a law that is written as a difference of numbers of order one keeps no more than their rounding
    assert law.f(np.array(q)) == pytest.approx(value, rel=5e-15, abs=1e-15 if rounded else 0.0)


@laws
@slopes
def test_R_and_its_derivative(name, q):
    law, f, rounded = EXACT[name]
    # near 0, q/f(q) loses all digits in a law written as a difference; the polynomial keeps 1e-16/0.0056
    assert law.R(q) == pytest.approx(exact(R_exact(f), q), rel=1e-13 if rounded else 1e-14)
    # differentiating a polynomial of degree 13 on |q| <= 0.05 amplifies rounding by up to 13²/0.05 = 3400
    assert law.R_derivative(q) == pytest.approx(exact(R_derivative_exact(f), q), rel=1e-10)


@laws
def test_R_maps_arrays_of_any_shape_and_increases(name):
    law = EXACT[name][0]
    q = np.linspace(-0.9, 3.0, 60).reshape(3, 20)
    assert law.R(q).shape == law.R_derivative(q).shape == q.shape
    assert np.all(np.diff(law.R(q.ravel())) > 0)


@laws
def test_inverse_returns(name):
    law = EXACT[name][0]
    q = np.concatenate([[-0.99, -0.5, -1e-3], np.linspace(0.0, 5.0, 41), [50.0]])
    y = law.f(q)
    # rounding of y alone moves the inverse by eps |y|/f'; allowed are 16 of these and of 1 + q
    allowed = 16 * np.finfo(float).eps * (np.abs(y) / law.derivative(q) + 1 + q)
    assert np.all(np.abs(law.inverse(y) - q) <= allowed)
    assert law.inverse(y.reshape(3, -1)).shape == (3, 15)


@pytest.mark.parametrize(
    ("law", "y"),
    [(rational(), 1.0), (rational(), 2.0), (power(M), 1 / M), (power(M), 7.0), (EXACT["cancelling"][0], 1.5)],
)
def test_inverse_does_not_exist_above_the_supremum(law, y):
    with pytest.raises(ValueError, match="does not reach"):
        law.inverse(np.array([0.1, y]))


@pytest.mark.parametrize("q0", [-0.9, -0.4, 0.02, 1.0, 30.0])
@laws
def test_decay_solves_its_equation(name, q0):
    """The distance over which q falls from q0 is ∫ R'(q) dq/q, here by quadrature in ln|q|."""
    law, f, _ = EXACT[name]
    distances = np.array([[0.0, 0.3], [1.0, 4.0]])
    q = law.decay(q0, distances)
    assert q[0, 0] == pytest.approx(q0, rel=1e-15)
    for fallen, distance in zip(q.ravel()[1:], distances.ravel()[1:], strict=True):
        found, _ = quad(
            lambda s: exact(R_derivative_exact(f), math.copysign(math.exp(s), q0)),
            math.log(abs(fallen)), math.log(abs(q0)), epsabs=1e-13, epsrel=1e-13,
        )  # fmt: skip
        # the integrator keeps 1e-13 a step, R' near q = 0 on average 1e-12 (1e-10 at worst, at |q| = 0.05)
        assert found == pytest.approx(distance, rel=1e-11)


@pytest.mark.parametrize("q", [-0.05, -0.03, 1e-6, 0.02, 0.05, 0.051])
def test_R_of_a_law_that_bends_within_the_polynomials_range(q):
    """f = (1 - (1+q)^-100)/100 falls by a factor of 170 there: a polynomial of degree 13 is good to 1e-6 of R'."""
    law, f = power(100.0), power_exact(100)
    assert law.R(q) == pytest.approx(exact(R_exact(f), q), rel=1e-12)  # rounding of the largest value
    assert law.R_derivative(q) == pytest.approx(
        exact(R_derivative_exact(f), q), rel=1e-9
    )  # an end of a range amplifies it


def test_decay_of_nothing_and_far_away():
    for law in (rational(), log()):
        assert np.all(law.decay(0.0, np.array([0.0, 3.0])) == 0.0)
        assert 0.0 <= law.decay(1.0, np.array(2000.0)) < 1e-300
    assert rational().decay(-0.5, 2.0) == pytest.approx(-0.5 * math.exp(-2.0), rel=1e-15)


@pytest.mark.parametrize("q", [-0.9, -0.1, 0.3, 20.0])
def test_power_law_ends_in_the_logarithm_and_meets_the_rational_law(q):
    m, L = 1e-4, math.log1p(q)
    small = power(m)
    # (1 - e^{-mL})/m = L - mL²/2 + O(m²L³/6): the first term is seen to a relative mL/3
    assert small.f(q) - L == pytest.approx(-m * L**2 / 2, rel=m * abs(L))
    assert small.derivative(q) * (1 + q) - 1 == pytest.approx(-m * L, rel=m * abs(L))
    assert small.inverse(L) - q == pytest.approx(m * L**2 / 2 * (1 + q), rel=2 * m * abs(L))
    one, other = power(1.0), rational()
    for name in ("f", "derivative", "R"):
        # a handful of roundings in exp and log of numbers below 10
        assert getattr(one, name)(q) == pytest.approx(getattr(other, name)(q), rel=4e-15)
    assert one.inverse(other.f(q)) == pytest.approx(q, rel=1e-13)  # y/(1-y) loses a factor 1 + q = 21


@pytest.mark.parametrize("m", [0.0, -1.0, math.nan, math.inf, 1e-200, 101.0])
def test_power_refuses_exponents_out_of_range(m):
    with pytest.raises(InputError, match=re.escape(f"m = {m} must be a positive number, at most 100")):
        power(m)


INADMISSIBLE = {  # expression -> what the message says, and whether q is a place where that is so
    "q/(1+q) + 0.125": ("f(0) = 0", lambda q: q == 0),
    "q/(1+q) - q/2": ("f' > 0", lambda q: (1 + q) ** -2 <= 0.5),
    "-log(1+q)": ("f' > 0", lambda q: True),
    "log(1+q) + (exp(-(q-3)**2) - exp(-9))/10": (
        "f'' < 0",
        lambda q: -((1 + q) ** -2) + (4 * (q - 3) ** 2 - 2) / 10 * math.exp(-((q - 3) ** 2)) >= 0,
    ),
    "sqrt(1+q) - 1": ("f -> -infinity as q -> -1", lambda q: q < -0.9999),
    "log(2+q) - log(2)": ("f -> -infinity as q -> -1", lambda q: q < -0.9999),
    "q/(1+q) + q/100": ("f(q)/q -> 0", lambda q: q > 1e4),
    "log(1+q) + 0*sqrt(500-q)": ("that f is finite", lambda q: 1.04 * (1 + q) > 501),  # differences reach 4 % further
}


@pytest.mark.parametrize("text", INADMISSIBLE)
def test_each_assumption_is_tested(text):
    assumption, holds_at = INADMISSIBLE[text]
    with pytest.raises(InputError) as refused:
        expression(text)
    message = str(refused.value)
    assert f"the law is not an erosion function: {assumption}" in message
    q = float(re.search(r"fails at q = ([-+.\de]*\d)", message)[1])
    # laws are sampled in steps of 1 % of 1 + q, and the left end of a step is named
    assert holds_at(q) or holds_at(1.01 * (1 + q) - 1)


def test_any_function_of_q_may_be_a_law(tmp_path):
    def only_numbers(q):
        return math.log(1.0 + q) if q > -1 else -math.inf

    def wrong_on_arrays(q):
        return np.log1p(q) * np.size(q)

    q = np.array([[-0.7, -0.01], [0.2, 9.0]])
    for f in (only_numbers, wrong_on_arrays, np.log1p):
        # 1 + q is rounded before the logarithm
        np.testing.assert_allclose(erosion_law(f).f(q), np.log1p(q), rtol=1e-13)
    given_all = erosion_law(np.log1p, derivative=lambda q: 1 / (1 + q), inverse=np.expm1)
    assert np.array_equal(given_all.derivative(q), 1 / (1 + q))
    assert np.array_equal(given_all.inverse(q), np.expm1(q))

    (tmp_path / "law.py").write_text("import math\ndef f(q):\n    return math.log(1 + q)\n")
    law = from_file(tmp_path / "law.py", "f")
    assert law.table == {"law": "python", "file": str(tmp_path / "law.py"), "function": "f"}
    np.testing.assert_allclose(law.f(q), np.log1p(q), rtol=1e-13)


@pytest.mark.parametrize(
    ("content", "function", "words"),
    [
        ("import no_such_module_anywhere\n", "f", "ModuleNotFoundError"),
        ("def f(q:\n", "f", "SyntaxError"),
        ("raise RuntimeError('no')\n", "f", "RuntimeError: no"),
        ("import sys\nsys.exit(0)\n", "f", "SystemExit"),
        ("def g(q):\n    return q\n", "f", "function = 'f' is not defined in law.py"),
        ("f = 3\n", "f", "function = 'f' is not defined in law.py"),
        ("def f(q, p):\n    return q\n", "f", "cannot be evaluated: TypeError"),
        ("def f(q):\n    return 'much'\n", "f", "cannot be evaluated"),
        ("def f(q):\n    return None\n", "f", "f(0) = 0 fails at q = 0, where f = nan"),
        ("def f(q):\n    return 1/0\n", "f", "cannot be evaluated: ZeroDivisionError"),
        ("def f(q):\n    return q\n", "f", "not an erosion function"),
        (b"\xff\xfe\x00", "f", "could not be run"),
    ],
)
def test_python_files_that_hold_no_law(tmp_path, content, function, words):
    path = tmp_path / "law.py"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(InputError, match=re.escape(words)):
        from_file(path, function)


@pytest.mark.parametrize("name", ["absent.py", ".", "law.txt", "x" * 5000 + ".py", "nul\0.py"])
def test_python_files_that_are_none(tmp_path, name):
    (tmp_path / "law.txt").write_text("def f(q):\n    return q/(1+q)\n")
    with pytest.raises(InputError, match="file = '"):
        from_file(tmp_path / name, "f")


ATTACKS = {
    "import": "__import__('os').system('touch pwned')",
    "open": "open('pwned', 'w')",
    "method": "q.tofile('pwned')",
    "attribute": "q.shape",
    "dunder": "q.__class__.__base__.__subclasses__()",
    "attribute of a function": "exp.__self__",
    "attribute of a number": "(1).real",
    "subscript": "q[0]",
    "name": "pi*q/(1+q)",
    "function as a value": "exp",
    "q called": "q(1)",
    "unknown function": "tan(q)",
    "builtin": "abs(q)",
    "call of a call": "exp(q)(q)",
    "lambda": "(lambda: open('pwned', 'w'))()",
    "list comprehension": "[open('pwned', 'w') for _ in (1,)]",
    "generator": "exp(x for x in (q,))",
    "string": "'q'",
    "f-string": 'f\'{open("pwned", "w")}\'',
    "bytes": "b'q'",
    "tuple": "(q, q)",
    "walrus": "(f := q)",
    "condition": "q if q > 0 else 2*q",
    "comparison": "q < 1",
    "boolean": "True*q",
    "and": "q and q",
    "not": "not q",
    "none": "None",
    "ellipsis": "...",
    "complex": "1j*q",
    "complex root": "(-1)**0.5*q",
    "complex root made real": "((-1)**0.5)**2*0 + q/(1+q)",
    "infinite": "1e999*q",
    "integer": "q*" + "9" * 900,
    "keyword": "exp(x=q)",
    "keyword beside": "exp(q, out=q)",
    "star": "exp(*[q])",
    "two arguments": "log(q, 2)",
    "no argument": "exp()",
    "floor division": "q//1",
    "modulo": "q%2",
    "matrix product": "q@q",
    "bits": "q|1",
    "shift": "1<<10**9",
    "invert": "~q",
    "huge power": "9**9**9**9**9",
    "huge power of q": "q**9**9**9",
    "huge power, negative": "-10**10**10*q",
    "division by zero": "q/0",
    "constant division by zero": "1/0 + q/(1+q)",
    "statement": "import os",
    "two statements": "q; open('pwned', 'w')",
    "assignment": "q = 1",
    "await": "await q",
    "yield": "(yield q)",
    "empty": "",
    "blank": "   ",
    "unfinished": "q/(1+",
    "nested parentheses": "(" * 450 + "q" + ")" * 450,
    "nested calls": "exp(" * 190 + "q" + ")" * 190,
    "signs": "-" * 998 + "q",
    "sums": "q" + "+q" * 499,
    "powers": "q" + "**q" * 300,
    "very long": "q/(1+q)" + "+0*q" * 100_000,
    "null": "q\0",
    "surrogate": "q\ud800",
    "comment": "# q",
    "newline": "q/(1+q)\nopen('pwned', 'w')",
    "unicode name": "ｑ.real",
    "keyword after a number": "1or q",
    "unknown escape": "'\\d'",
}
# arithmetic all the same, and refused for its values
ARITHMETIC = {"complex root", "complex root made real", "division by zero", "constant division by zero", "nested calls"}
ARITHMETIC |= {"huge power", "huge power of q", "huge power, negative", "powers"}


@pytest.mark.parametrize("name", ATTACKS)
def test_attacks_are_refused_and_never_run(name, in_tmp, recwarn):
    started = time.perf_counter()
    with pytest.raises(InputError) as refused:
        expression(ATTACKS[name])
    assert list(recwarn) == []  # Python has some of the syntax, which would be further lines on stderr
    words = (
        "at most 1000 are allowed" if name == "very long" else "allowed are numbers, q, + - * / ** and the functions"
    )
    assert ("the law is not an erosion function" if name in ARITHMETIC else words) in str(refused.value)
    assert time.perf_counter() - started < 5.0  # milliseconds are usual; a huge power would take for ever
    assert list(in_tmp.iterdir()) == []
    assert len(str(refused.value)) < 3000


@pytest.mark.parametrize(
    ("text", "equal"),
    [
        ("q/(1+q)", lambda q: q / (1 + q)),
        ("  log1p(q)\n", np.log1p),
        ("1-exp(-log(1+q))", lambda q: q / (1 + q)),
        ("-expm1(-2*log1p(q))/2", lambda q: (1 - (1 + q) ** -2) / 2),
        ("+(1 - (1+q)**-2)/2", lambda q: (1 - (1 + q) ** -2) / 2),
        ("2**3*log(1+q)/10_0.e-1", lambda q: 0.8 * np.log1p(q)),
    ],
)
def test_expressions_mean_what_they_say(text, equal):
    q = np.array([-0.9, -0.3, 0.4, 12.0])
    law = expression(text)
    np.testing.assert_allclose(law.f(q), equal(q), rtol=1e-14)
    assert law.table == {"law": "expression", "expression": text.strip()}
    assert law.f(0.4) == pytest.approx(equal(0.4), rel=1e-14)
