import math

import pytest

from jaxcell.base.documents import Fields, checked_number, decode_json


@pytest.mark.parametrize(
    ("value", "text"), [(3, False), (-2.5, False), ("1e3", True), (" 4 ", True), (10**9, False)]
)
def test_numbers_are_read(value, text):
    assert checked_number("x", value, text=text) == float(value)


@pytest.mark.parametrize("value", [True, None, math.nan, -math.inf, "3", [3], 10**400, 2e9, -2e9])
def test_other_values_are_refused_as_numbers(value):
    with pytest.raises(ValueError, match=r"^x: expected a finite number, got "):
        checked_number("x", value)


@pytest.mark.parametrize("value", ["", "far", "nan", "inf", "1e999", False, None, b"3"])
def test_other_texts_are_refused_as_numbers(value):
    with pytest.raises(ValueError, match=r"^y\[0\]: expected a size, got "):
        checked_number("y[0]", value, "a size", text=True)


def test_parts_are_named_by_their_place():
    document = decode_json('{"robots": [{"at": [1, 2]}, {"at": [1]}], "more": [{}, 3]}', "a team")
    fields = Fields(document, "team.json: ")
    first, second = fields.parts("robots")
    assert first.numbers("at", (2,), whole=True).tolist() == [1, 2]
    with pytest.raises(ValueError, match=r"^team\.json: robots\[1\]\.at: expected numbers, 2 of"):
        second.numbers("at", (2,), whole=False)
    with pytest.raises(ValueError, match=r"^team\.json: robots\[1\]\.name: it is missing$"):
        second.needed("name")
    with pytest.raises(ValueError, match=r"^team\.json: robots\[0\]\.n: expected a whole .* None$"):
        first.whole("n", 0, 3)
    with pytest.raises(ValueError, match=r"^team\.json: more\[1\]: expected an object, got 3$"):
        fields.parts("more")
    with pytest.raises(ValueError, match=r"^team\.json: none: expected a list, got None$"):
        fields.parts("none")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"a": 1, "a": 2}', "not valid JSON, or cut short: the key 'a' is repeated"),
        ("[", "not valid JSON, or cut short: "),
        ("[" * 100_000, "not a map: its brackets are nested too deeply"),
    ],
)
def test_damaged_json_is_refused(text, message):
    with pytest.raises(ValueError, match=rf"^{message}"):
        decode_json(text, "a map")
