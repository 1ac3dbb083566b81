"""One process at a time in a folder."""

import subprocess
import sys
import threading

import pytest
from mi_ellipse.files.lock import only_one

HOLD = """
import pathlib, sys, time
from mi_ellipse.files.lock import only_one
with only_one(pathlib.Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""


def test_a_second_process_is_refused_until_the_first_is_killed(tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout.readline() == "held\n"
        with (
            pytest.raises(ValueError, match=f"{tmp_path} is in use by another"),
            only_one(tmp_path),
        ):
            pytest.fail("held by two")
    finally:
        process.kill()  # It cannot free anything itself.
        process.communicate()
    with only_one(tmp_path):
        pass


def test_blocks_of_one_thread_may_lie_in_one_another(tmp_path):
    with only_one(tmp_path):
        with only_one(tmp_path):
            pass
        assert refused(tmp_path)  # The outer block still holds it.
    assert not refused(tmp_path)


def refused(folder):
    """Tell whether another thread cannot have the folder."""
    found = []

    def attempt():
        try:
            with only_one(folder):
                found.append(False)
        except ValueError:
            found.append(True)

    thread = threading.Thread(target=attempt)
    thread.start()
    thread.join()
    return found[0]
