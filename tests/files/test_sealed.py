"""JSON files with a checksum: every change of their content is noticed."""

import json
import random

import pytest
from mi_ellipse.files import sealed

CONTENT = {"numbers": [1, 0.1, 1e-300], "text": "Größe", "none": None}


def test_what_is_written_is_read_back(tmp_path):
    file = tmp_path / "a.json"
    sealed.write_json(file, CONTENT)
    assert sealed.read_json(file) == CONTENT


def test_no_altered_byte_changes_the_content_in_silence(tmp_path):
    file = tmp_path / "a.json"
    sealed.write_json(file, CONTENT)
    whole = file.read_bytes()
    choose = random.Random(1)
    for place in range(len(whole)):
        altered = bytearray(whole)
        altered[place] = choose.choice([byte for byte in range(256) if byte != whole[place]])
        file.write_bytes(altered)
        try:
            found = sealed.read_json(file)
        except ValueError:
            continue
        assert found == CONTENT  # The byte was white space between the entries.


@pytest.mark.parametrize("text", ["", "[]", "{}", "null", json.dumps(CONTENT), '{"checksum": 1}'])
def test_other_files_are_refused(tmp_path, text):
    file = tmp_path / "a.json"
    file.write_text(text)
    with pytest.raises(ValueError, match=f"{file} is damaged"):
        sealed.read_json(file)
