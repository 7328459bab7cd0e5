"""JSON5 with the lines of its values."""

import json

import json5
import pytest
from esslingen import json_values
from hypothesis import given

from sfglab.deploy.shapes import read_json5
from sfglab.documents import DocumentError


@pytest.mark.parametrize(
    "text",
    [
        "{a: 1, // one\n 'b': \"x // no comment\", /* two\nlines */ c: [1, 2,], }",
        '{"a":{"b":[true,false,null,1.5e3]},}',
        "{\tplugins: {\n\t\tx: 'it\\'s \"so\"' } }",
        "[]",
    ],
)
def test_json5_is_read_as_other_readers_do(text):
    assert read_json5(text, "x.json5").value == json5.loads(text)


@given(json_values)
def test_every_json_document_is_read_back(value):
    assert read_json5(json.dumps(value, indent=1), "x.json").value == value


def test_lines_are_those_of_the_file_and_what_is_no_json5_is_refused():
    document = read_json5("{\n  // a comment\n  a: {b: {\n    c: {},\n  }},\n}", "b.json5")
    assert document.place(("a", "b", "c")).line == 4
    with pytest.raises(DocumentError):
        read_json5("{a: [}", "b.json5")
