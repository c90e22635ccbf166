"""The two ways in which a user is told that something cannot be done."""


class InputError(ValueError):
    """Bad input: one sentence that names the file, the key, the value and what is allowed (exit code 2)."""


class RunError(RuntimeError):
    """A run or a check that failed: one sentence that says when, where, why and what to try (exit code 1)."""
