"""Damages files, and checks that readers and commands end well.

`JAXCELL_FUZZ=2000` in the environment runs that many cases per reader, different ones each time.
Without it there are few cases, and always the same ones.
"""

import contextlib
import copy
import json
import os
import re
import resource
import signal
from pathlib import Path

from hypothesis import HealthCheck, settings, strategies as st


DATA = Path(__file__).parents[1] / "data"

_CASES = int(os.environ.get("JAXCELL_FUZZ", "0"))
_SECONDS = 5
_MAX_BYTES = 3 * 2**30
_LONGEST_LINE = 1500

# Replacements of numbers, names and brackets.
_TOKENS = [
    *(b"", b" ", b"\n", b"\0", b"\xff", b"\xef\xbb\xbf", b"\xed\xa0\x80"),
    "é\u202e\U0001f916".encode(),
    *(b"0", b"-1", b"1e400", b"-0.0", b"nan", b"-inf", b"1e-300", b"1e300", b"999999999999"),
    *(b"2147483648", b"-9223372036854775809", b"1" * 400, b"9" * 5000, b"true", b"null", b"''"),
    *(b"{", b"}", b"[", b"]", b"(", b'"', b"<", b">", b"&", b"&a;", b"<!--", b"#", b";", b":"),
    *(b"[" * 20_000, b"{'a':" * 5000, b"<a>" * 5000, b"=", b",", b"*a", b"&a [*a]", b"- ", b"\\u"),
]

# Replacements of parts of a JSON document. Text between @ is written as it is.
_RAW = {
    "@nested@": "[" * 50_000 + "]" * 50_000,
    "@objects@": '{"a":' * 50_000 + "0" + "}" * 50_000,
    "@digits@": "9" * 5000,
    "@surrogate@": '"\\ud800"',
    "@huge@": "1e999",
}
_PARTS = st.one_of(
    st.sampled_from(
        [
            *(None, True, False, 0, 1, -1, 2, 0.5, -0.0, 4, 7, 255, 256, 65536),
            *(2**31 - 1, 2**31, 2**32, 2**53 + 1, 2**63, 2**64, 10**9, 10**18, 10**400),
            *(-(2**31) - 1, -(10**400), 1e-9, 1e-300, 5e-324, 1e9, 1e18, 1.7e308),
            *(float("nan"), float("inf"), float("-inf")),
            *("", " ", "x", "0", "1.0", "nan", "\n", "\0", "a\u202eb", "/", "..", "x" * 5000),
            *([], {}, [[]], [{}], [0], [0, 0], [[0, 0]], {"": 0}, [None] * 3, [0] * 3000),
            *_RAW,
        ]
    ),
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
        lambda inner: (
            st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4)
        ),
        max_leaves=6,
    ),
)


def cases(few=100):
    """The number of cases of a property."""
    return settings(
        max_examples=_CASES or few,
        derandomize=not _CASES,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )


class TooSlowError(BaseException):
    """Not an `Exception`, because a reader may catch those."""


@contextlib.contextmanager
def limits():
    """Ends a block after 5 seconds of the processor, or when it takes 3 GiB more memory."""

    def end(*_):
        raise TooSlowError(f"it took more than {_SECONDS} s")

    before = signal.signal(signal.SIGPROF, end)
    sizes = resource.getrlimit(resource.RLIMIT_AS)
    statm = Path("/proc/self/statm")
    if statm.exists():
        now = int(statm.read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (now + _MAX_BYTES, sizes[1]))
    signal.setitimer(signal.ITIMER_PROF, _SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
        resource.setrlimit(resource.RLIMIT_AS, sizes)


def place(folder, name, content):
    """Writes a file, and gives its path."""
    path = folder / name
    path.write_bytes(content)
    return path


def reads_or_refuses(read, path, name=None):
    """Checks that a file is read, or refused in a line that names it; true if it is read."""
    before = tree(path.parent)
    try:
        with limits():
            read(path)
        refused = False
    except (ValueError, OSError) as error:
        assert (name or path.name) in str(error), repr(error)
        assert len(str(error)) < _LONGEST_LINE, str(error)[:_LONGEST_LINE]
        refused = True
    assert tree(path.parent) == before
    return not refused


def answers(main, capsys, *args, out=None):
    """Runs a command, checks how it ends, and gives its exit status."""
    capsys.readouterr()
    with limits():
        try:
            status = main([*map(str, args)])
        except SystemExit as error:
            # The parser of the command line prints its error in a box.
            captured = capsys.readouterr()
            assert error.code == 2, args
            assert "Traceback" not in captured.err
            assert captured.err
            return 2
    captured = capsys.readouterr()
    assert status in (0, 1, 2), (args, status)
    if status == 2:
        assert len(captured.err.splitlines()) == 1, captured.err
        assert captured.err.startswith("jaxcell "), captured.err
        assert len(captured.err) < _LONGEST_LINE, captured.err[:_LONGEST_LINE]
        assert len(captured.err.split(":", 1)[1].split()) > 2, captured.err
    if out is not None:
        left = [name for name in tree(out) if re.search(r"(^|/)\.[^/]*-[0-9a-f]{8}", name)]
        assert not left, left
    return status


def tree(folder):
    """The names of all files and folders in a folder."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


@st.composite
def damaged(draw, corpus):
    """Draws a file, and edits it: its name and its bytes."""
    name = draw(st.sampled_from(sorted(corpus)))
    content = corpus[name]
    for _ in range(draw(st.integers(1, 4))):
        content = _edited(draw, content)
    return name, content


def _edited(draw, content):
    begin = draw(st.integers(0, len(content)))
    end = min(begin + draw(st.integers(0, 12)), len(content))
    kind = draw(st.sampled_from(["replace", "flip", "cut", "drop", "repeat", "code", "word"]))
    if kind == "flip" and begin < len(content):
        flipped = content[begin] ^ draw(st.integers(1, 255))
        return content[:begin] + bytes([flipped]) + content[begin + 1 :]
    if kind == "cut":
        return content[:begin]
    if kind == "drop":
        return content[:begin] + content[begin + draw(st.integers(1, 200)) :]
    if kind == "repeat":
        again = content[begin : begin + 200] * draw(st.integers(1, 20))
        return content[:begin] + again + content[begin:]
    if kind == "code":
        code = draw(st.sampled_from(["utf-16", "utf-32", "utf-8-sig", "cp500"]))
        return content.decode("latin-1").encode(code, "replace")
    words = [*re.finditer(rb"[\w.+-]+", content[:20_000])]
    if kind == "word" and words:
        begin, end = draw(st.sampled_from(words)).span()
    token = draw(st.sampled_from(_TOKENS) | st.binary(max_size=12))
    return content[:begin] + token + content[end:]


@st.composite
def changed_json(draw, corpus):
    """Draws a JSON document, and changes parts of it: its name and its text."""
    name = draw(st.sampled_from(sorted(corpus)))
    document = json.loads(json.dumps(corpus[name]))
    for _ in range(draw(st.integers(1, 3))):
        document = _changed(draw, document)
    text = json.dumps(document)
    if draw(st.integers(0, 9)) == 0 and isinstance(document, dict) and document:
        key = draw(st.sampled_from(sorted(document)))
        text = "{" + f"{json.dumps(key)}: {json.dumps(draw(_PARTS))}, " + text[1:]
    for mark, raw in _RAW.items():
        text = text.replace(f'"{mark}"', raw)
    return name, text.encode("utf-8", "surrogatepass")


def _changed(draw, document):
    # Walk down from the top, so that all levels are equally likely.
    where, at = [], document
    while isinstance(at, dict | list) and at and (not where or draw(st.booleans())):
        key = draw(st.sampled_from(sorted(at) if isinstance(at, dict) else range(len(at))))
        where.append((at, key))
        at = at[key]
    if not where:
        return _part(draw)
    parent, key = where[-1]
    kind = draw(st.sampled_from(["replace", "replace", "replace", "delete", "rename", "repeat"]))
    if kind == "delete":
        del parent[key]
    elif kind == "rename" and isinstance(parent, dict):
        parent[draw(st.text(max_size=5))] = parent.pop(key)
    elif kind == "repeat" and isinstance(parent, list):
        parent[key:key] = [at] * draw(st.sampled_from([1, 2, 500]))
    else:
        parent[key] = _part(draw)
    return document


def _part(draw):
    # A copy, because a later change of a shared list would change both places.
    return copy.deepcopy(draw(_PARTS))
