"""Find the one line in an error of Mitsuba or Dr.Jit that says what is wrong."""

import re

# An exception inside a Python plugin reaches the caller as text with its whole traceback.
_TRACEBACK = re.compile(r"Traceback \(most recent call last\):\n(?:[ \t]+.*\n)+")
_SOURCE_LOCATION = re.compile(r"\[\w+\.(?:cpp|h):\d+\] ")


def innermost_cause(error: BaseException) -> str:
    """
    Return the message of the error at the bottom of an exception's chain, in one line.

    An exception during ``mi.render`` arrives as "error while performing a custom differentiable
    operation. (see above)"; one in a plugin's constructor as a ``RuntimeError`` that quotes a
    traceback. Both hide the sentence that helps.
    """
    while (cause := _cause(error)) is not None:
        error = cause
    text = _SOURCE_LOCATION.sub("", _TRACEBACK.sub("", str(error)))
    return " ".join(text.split()) or type(error).__name__


def _cause(error: BaseException) -> BaseException | None:
    """Return what Python would print above `error`: nothing after ``raise … from None``."""
    return error.__cause__ or (None if error.__suppress_context__ else error.__context__)
