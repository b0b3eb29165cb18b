"""Documents: which texts are refused, and that every error names the source, the key and the value."""

from __future__ import annotations

import json
import math
from typing import Annotated, ClassVar, Literal

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.documents import MAX_ENTRIES, MAX_NESTING, Document, from_json, from_plain, from_toml, to_json
from hil.core.errors import DocumentError


class Leaf(Document, frozen=True):
    size: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)]
    count: Annotated[int, msgspec.Meta(ge=1)] = 1
    unit: Literal["m", "rad"] = "m"


class Round(Document, frozen=True, tag_field="kind", tag="round"):
    radius: float


class Square(Document, frozen=True, tag_field="kind", tag="square"):
    side: float
    corner: Literal["sharp", "blunt"] = "sharp"


class Tree(Document, frozen=True):
    leaves: Annotated[dict[str, Leaf], msgspec.Meta(max_length=3)]
    rows: list[list[float]] = msgspec.field(default_factory=list)
    shape: Round | Square = Round(1.0)
    version: Literal[1] = 1


def refusal(plain: object) -> str:
    with pytest.raises(DocumentError) as caught:
        from_plain(plain, Tree, "tree.toml")
    return str(caught.value)


LEAF = {"size": 1.0}


LEAF_KEYS = "Valid keys: size, count, unit"
TREE_KEYS = "Valid keys: leaves, rows, shape, version"


@pytest.mark.parametrize(
    ("plain", "text"),
    [
        ({"leaves": {"a": {"size": 11.3}}}, "leaves.a.size is 11.3, but must be at most 10.0"),
        ({"leaves": {"a": {"size": -0.1}}}, "leaves.a.size is -0.1, but must be at least 0.0"),
        ({"leaves": {"a": {"size": "big"}}}, "leaves.a.size is 'big', but must be a number"),
        ({"leaves": {"a": {"size": "b" * 500}}}, f"leaves.a.size is '{'b' * 80}'…, but must be a number"),
        ({"leaves": {"a": {"size": True}}}, "leaves.a.size is true, but must be a number"),
        ({"leaves": {"a": {"size": None}}}, "leaves.a.size is null, but must be a number"),
        ({"leaves": {"a": LEAF | {"count": 1.5}}}, "leaves.a.count is 1.5, but must be a whole number"),
        ({"leaves": {"a": LEAF, "b": {"size": 12}}}, "leaves.b.size is 12, but must be at most 10.0"),
        ({"leaves": {"a": LEAF | {"count": 1}, "b": {}}}, "leaves.b: missing key size"),
        ({"leaves": {"a": LEAF | {"unit": "cm"}}}, "leaves.a.unit is 'cm', but must be 'm' or 'rad'"),
        ({"leaves": {"a": LEAF | {"cm": 1}}}, f"leaves.a: unknown key cm. {LEAF_KEYS}"),
        (
            {"leaves": {"a": LEAF | {"cuont": 1}}},
            f"leaves.a: unknown key cuont; did you mean count? {LEAF_KEYS}",
        ),
        ({"leaves": {"a": {"Size": 1}}}, f"leaves.a: unknown key Size; did you mean size? {LEAF_KEYS}"),
        ({"leaves": {}, "leafs": {}}, f"unknown key leafs; did you mean leaves? {TREE_KEYS}"),
        ({"leafs": {}}, f"unknown key leafs; did you mean leaves? {TREE_KEYS}"),
        ({"leaves": {}, "a b\n": {}}, rf"unknown key 'a b\n'. {TREE_KEYS}"),
        ({}, "missing key leaves"),
        ([], "the document is a list, but must be a table"),
        ({"leaves": 3}, "leaves is 3, but must be a table"),
        ({"leaves": dict.fromkeys("abcd", LEAF)}, "leaves has 4 keys, but must have at most 3"),
        ({"leaves": {}, "rows": [[1.0], [2.0, "x"]]}, "rows[1][1] is 'x', but must be a number"),
        ({"leaves": {}, "rows": [[[]]]}, "rows[0][0] is a list, but must be a number"),
        ({"leaves": {}, "version": 2}, "version is 2, but must be 1"),
        ({"leaves": {}, "shape": {"kind": "oval"}}, "shape.kind is 'oval', but must be 'round' or 'square'"),
        (
            {"leaves": {}, "shape": {"kind": "square", "side": 1, "corner": "red"}},
            "shape.corner is 'red', but must be 'blunt' or 'sharp'",
        ),
        (
            {"leaves": {}, "shape": {"kind": "round", "side": 1, "radius": 2.0}},
            "shape: unknown key side. Valid keys: kind, radius",
        ),
        (
            {"leaves": {}, "shape": {"radius": 1}},
            "shape: missing key kind, which must be 'round' or 'square'",
        ),
        # Numbers that are not finite are refused in every place.
        ({"leaves": {"a": {"size": math.nan}}}, "leaves.a.size: nan is not a finite number"),
        ({"leaves": {}, "rows": [[1.0], [math.inf]]}, "rows[1][0]: inf is not a finite number"),
        ({"leaves": {}, "rows": [[-math.inf]]}, "rows[0][0]: -inf is not a finite number"),
        ({"leaves": {"a": LEAF | {"count": 2**63}}}, "leaves.a.count: an integer of more than 64 bits"),
        ({"leaves": {"a": {"size": -(10**5000)}}}, "leaves.a.size: an integer of more than 64 bits"),
        ({"leaves": {}, "rows": [[0.0] * (MAX_ENTRIES + 1)]}, "rows[0]: 10001 entries, more than 10000"),
        ({"leaves": dict.fromkeys(map(str, range(10_001)), 1)}, "leaves: 10001 entries, more than 10000"),
        # Keys that look like msgspec's own paths.
        ({"leaves": {"...": {"size": 11}}}, "leaves.....size is 11, but must be at most 10.0"),
        ({"leaves": {"0": {"size": 11}}}, "leaves.0.size is 11, but must be at most 10.0"),
    ],
)
def test_refusals_name_source_path_value_and_limit(plain: object, text: str) -> None:
    assert refusal(plain) == f"tree.toml: {text}"


class Table(Document, frozen=True):
    max_entries: ClassVar[int] = 20_000
    rows: list[float]


def test_a_type_may_allow_longer_lists() -> None:
    assert len(from_plain({"rows": [0.0] * 20_000}, Table, "t").rows) == 20_000
    with pytest.raises(DocumentError, match=r"^t: rows: 20001 entries, more than 20000$"):
        from_plain({"rows": [0.0] * 20_001}, Table, "t")


def test_all_unknown_and_missing_keys_are_reported_at_once() -> None:
    plain = {"leafs": {}, "shape": {"kind": "square", "corners": 1}, "leaves": {"a.b": LEAF, "a": {"b": 11}}}
    assert refusal(plain).splitlines() == [
        f"tree.toml: unknown key leafs; did you mean leaves? {TREE_KEYS}",
        "tree.toml: shape: unknown key corners; did you mean corner? Valid keys: kind, side, corner",
        "tree.toml: shape: missing key side",
        f"tree.toml: leaves.a: unknown key b. {LEAF_KEYS}",
        "tree.toml: leaves.a: missing key size",
    ]


def test_a_file_full_of_unknown_keys_gives_a_message_of_bounded_length() -> None:
    lines = refusal({f"k{number}": 1 for number in range(MAX_ENTRIES)}).splitlines()
    assert len(lines) == 21
    assert lines[-1] == "tree.toml: and more"


def test_the_place_is_right_where_two_tables_have_the_same_mistake() -> None:
    assert refusal({"leaves": {"a": {"size": 12}, "b": {"size": 12}}}) == (
        "tree.toml: leaves.a.size is 12, but must be at most 10.0"
    )


@pytest.mark.parametrize(
    "key", ["x - at `$.leaves.size.x", "x - at `$.leaves[...].size", "x - at `$[4]", "x - at `$.no[...]"]
)
def test_a_key_that_imitates_a_path_is_still_refused(key: str) -> None:
    assert refusal({"leaves": {"a": LEAF}, key: 1}).startswith("tree.toml: ")


def test_a_toml_date_is_refused_where_it_stands() -> None:
    with pytest.raises(DocumentError, match=r"^t: leaves\.a\.unit is 1979-05-27, but must be a text$"):
        from_toml("[leaves.a]\nsize = 1\nunit = 1979-05-27", Tree, "t")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("leaves = ", "Invalid value (at end of document)"),
        ("[leaves]\n[leaves]\n", "a table is given twice (at line 2, column 8): [leaves]"),
        ("rows = []\nrows = [[1]]\n", "a key or table is given twice (at line 2, column 13): rows = [[1]]"),
        ("rows" + ".a" * 100_000 + " = 1", "a dotted key has more than 32 parts (line 1)"),
        ("x = 1\nrows = { a" + '."a"' * 100_000 + " = 1 }", "a dotted key has more than 32 parts (line 2)"),
        ("rows = " + "9" * 5000, "limit"),
        ("rows = " + "[" * 5000, "nested too deeply"),
    ],
)
def test_text_that_is_not_toml(text: str, said: str) -> None:
    with pytest.raises(DocumentError, match=r"^t: not valid TOML: ") as caught:
        from_toml(text, Tree, "t")
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"leaves": }', "line 1 column 12"),
        ("", "Expecting value"),
        ('{"rows": ' + "9" * 5000 + "}", "limit"),
        ('{"rows": ' + "[" * 100_000, "nested too deeply"),
    ],
)
def test_text_that_is_not_json(text: str, said: str) -> None:
    with pytest.raises(DocumentError, match=r"^t: not valid JSON: ") as caught:
        from_json(text, Tree, "t")
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            '{"leaves": {"a": {"size": 1.0, "unit": "m", "size": -2000000}}}',
            "leaves.a: key size is given twice, as 1.0 and as -2000000; remove one",
        ),
        ('{"leaves": {}, "leaves": {}}', "key leaves is given twice, as {} and as {}; remove one"),
        (
            '{"leaves": {}, "leaves": {}, "leaves": 3}',
            "key leaves is given twice, as {} and as {}; remove one",
        ),
        (
            '{"rows": [{"a": 1, "a": [' + "1, " * 500 + "1]}]}",
            "rows[0]: key a is given twice, as 1 and as [" + "1, " * 19 + "1,…; remove one",
        ),
        (
            '{"leaves": {"a": {"x": 1, "x": 1}, "a": 2}}',
            'key a is given twice, as {"x": 1} and as 2; remove one',
        ),
    ],
)
def test_a_json_key_that_is_given_twice_is_refused_with_both_values(text: str, said: str) -> None:
    with pytest.raises(DocumentError) as caught:
        from_json(text, Tree, "t")
    assert said in str(caught.value)


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999", "-1e999"])
def test_json_numbers_that_are_not_finite_are_refused_by_key(number: str) -> None:
    with pytest.raises(DocumentError, match=r"^t: rows\[0\]\[0\]: -?(nan|inf) is not a finite number$"):
        from_json(f'{{"leaves": {{}}, "rows": [[{number}]]}}', Tree, "t")


@pytest.mark.parametrize(("depth", "said"), [(MAX_NESTING, "must be a number"), (900, "nested deeper")])
def test_deep_nesting_is_refused_before_it_can_exhaust_the_stack(depth: int, said: str) -> None:
    rows: object = 1.0
    for _ in range(depth - 1):
        rows = [rows]
    assert said in refusal({"leaves": {}, "rows": rows})


plain_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=5)
    | st.dates()
    | st.sampled_from(["m", "rad", "round", 1, 1.0]),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["leaves", "size", "rows", "shape", "kind", "...", "radius", "unit"])
            | st.text(max_size=4),
            inner,
            max_size=4,
        )
    ),
    max_leaves=12,
)


@given(plain_values)
def test_anything_at_all_is_read_or_refused(plain: object) -> None:
    try:
        tree = from_plain({"leaves": plain}, Tree, "t")
    except DocumentError as error:
        assert str(error).startswith("t: ")
    else:
        assert isinstance(tree, Tree)


sizes = st.floats(0.0, 10.0)
leaves = st.builds(Leaf, size=sizes, count=st.integers(1, 2**62), unit=st.sampled_from(["m", "rad"]))
finite = st.floats(allow_nan=False, allow_infinity=False)
trees = st.builds(
    Tree,
    leaves=st.dictionaries(st.text(max_size=4), leaves, max_size=3),
    rows=st.lists(st.lists(finite, max_size=3), max_size=3),
    shape=st.builds(Round, radius=finite) | st.builds(Square, side=finite),
)


@given(trees)
def test_json_is_read_back_to_an_equal_object(tree: Tree) -> None:
    text = to_json(tree)
    assert from_json(text, Tree, "t") == tree
    assert text.endswith("}\n") and json.loads(text)["version"] == 1


def test_documents_are_frozen() -> None:
    leaf = Leaf(size=1.0)
    with pytest.raises(AttributeError):
        leaf.size = 2.0  # type: ignore[misc]
