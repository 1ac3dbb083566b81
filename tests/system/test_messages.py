"""The one line of an error that helps."""

from mi_ellipse.system.messages import innermost_cause


def test_innermost_cause():
    outer = RuntimeError("(see above)")
    outer.__context__ = ValueError("the\n  cause")
    assert innermost_cause(outer) == "the cause"
    outer.__suppress_context__ = True
    assert innermost_cause(outer) == "(see above)"
    outer.__cause__ = KeyError("explicit")
    assert innermost_cause(outer) == "'explicit'"

    quoted = 'Traceback (most recent call last):\n  File "a.py", line 1, in f\n    x()\nKeyError: y'
    assert innermost_cause(RuntimeError(f"[a.cpp:1] At b: {quoted}")) == "At b: KeyError: y"
    assert innermost_cause(KeyboardInterrupt()) == "KeyboardInterrupt"
