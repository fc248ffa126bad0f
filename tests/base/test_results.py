"""Results are whole or missing, whatever interrupts a run, and mixtures of runs are refused."""

import contextlib
import os
import signal
import subprocess
import sys
import textwrap

import pytest

from jaxcell.base import results
from jaxcell.base.results import MANIFEST, Manifest, check_result, current_run, result_folder


def _write(out, **files):
    with result_folder(out) as folder:
        for name, text in files.items():
            (folder / name).write_text(text)
        Manifest.of(folder, ["groups"], {}, {}).write(folder)
        return current_run()


@contextlib.contextmanager
def _in_process(code, *arguments):
    words = [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        yield process


def _fail(folder):
    (folder / "a").write_text("2")
    raise ZeroDivisionError


def test_files_appear_together_at_the_end(tmp_path):
    out = tmp_path / "out"
    with result_folder(out) as folder:
        (folder / "a").write_text("1")
        Manifest.of(folder, ["groups"], {}, {}).write(folder)
        assert [path.name for path in out.iterdir() if not path.name.startswith(".")] == []
    assert sorted(path.name for path in out.iterdir()) == ["a", MANIFEST]


def test_an_error_leaves_nothing(tmp_path):
    out = tmp_path / "out"
    with pytest.raises(ZeroDivisionError), result_folder(out) as folder:
        _fail(folder)
    assert not out.exists()


def test_an_error_keeps_the_last_result(tmp_path):
    out = tmp_path / "out"
    run = _write(out, a="1")
    with pytest.raises(ZeroDivisionError), result_folder(out) as folder:
        _fail(folder)
    assert (out / "a").read_text() == "1"
    assert Manifest.read(out).run_id == run
    check_result(out)


def test_a_result_replaces_all_files_of_the_last_result_and_no_others(tmp_path):
    out = tmp_path / "out"
    first = _write(out, a="1", b="1")
    (out / "mine").write_text("keep")
    (out / "sub").mkdir()
    second = _write(out, a="2", c="2")
    assert first != second
    assert sorted(path.name for path in out.iterdir()) == ["a", "c", "mine", MANIFEST, "sub"]
    assert (out / "a").read_text() == "2"


def test_two_runs_at_once_are_refused(tmp_path):
    with (
        result_folder(tmp_path / "out"),
        pytest.raises(BlockingIOError, match=f"process {os.getpid()} on .* writes a result to it"),
        result_folder(tmp_path / "out"),
    ):
        pass


def test_a_file_of_another_run_is_refused(tmp_path):
    _write(tmp_path / "one", a="1", b="1")
    _write(tmp_path / "two", a="2", b="2")
    check_result(tmp_path / "one")
    os.replace(tmp_path / "two" / "a", tmp_path / "one" / "a")
    for path in (tmp_path / "one", tmp_path / "one" / "a"):
        with pytest.raises(ValueError, match="a: not the files that run"):
            check_result(path)
    check_result(tmp_path / "one" / "b")


def test_every_flipped_bit_is_found(tmp_path):
    _write(tmp_path / "out", a="some text", b="more")
    manifest = Manifest.read(tmp_path / "out")
    for name in ("a", "b"):
        path = tmp_path / "out" / name
        whole = path.read_bytes()
        for bit in range(8 * len(whole)):
            flipped = bytearray(whole)
            flipped[bit // 8] ^= 1 << bit % 8
            path.write_bytes(flipped)
            assert manifest.damage(tmp_path / "out") == [name]
        path.write_bytes(whole)
    assert manifest.damage(tmp_path / "out") == []


def test_a_newer_manifest_is_refused(tmp_path):
    _write(tmp_path / "out", a="1")
    path = tmp_path / "out" / MANIFEST
    path.write_text(path.read_text().replace('"version": 1', '"version": 2'))
    with pytest.raises(ValueError, match="version: expected at most 1, got 2; a newer jaxcell"):
        check_result(tmp_path / "out")


# At each step of the replacement of one result by another, the process dies as after SIGKILL.
_DIES = """
    import os, sys
    from pathlib import Path
    from jaxcell.base import results
    out, step = Path(sys.argv[1]), int(sys.argv[2])
    count = 0
    def dying(function):
        def stepped(*arguments, **options):
            global count
            count += 1
            if count == step:
                os._exit(9)
            return function(*arguments, **options)
        return stepped
    with results.result_folder(out) as folder:
        for name in "ac":
            (folder / name).write_text("2")
        results.Manifest.of(folder, [], {}, {}).write(folder)
        os.replace, Path.unlink = dying(os.replace), dying(Path.unlink)
"""


@pytest.mark.parametrize("step", range(1, 6))
def test_a_kill_during_the_replacement_is_seen_and_completed(tmp_path, step):
    out = tmp_path / "out"
    first = _write(out, a="1", b="1")
    with _in_process(_DIES, out, step) as process:
        died = process.wait() == 9
    if (out / ".writing" / MANIFEST).exists():
        with pytest.raises(ValueError, match="interrupted"):
            check_result(out)
    else:
        check_result(out)
    with pytest.raises(ZeroDivisionError), result_folder(out) as folder:
        _fail(folder)
    check_result(out)
    names = sorted(path.name for path in out.iterdir())
    assert names == ["a", "c", MANIFEST]
    assert died == (step < 5)
    assert (out / "a").read_text() == (out / "c").read_text() == "2"
    assert Manifest.read(out).run_id != first


_WAITS = """
    import signal, sys, time
    from pathlib import Path
    from jaxcell.base import process, results
    # A shell lets programs in the background ignore signals.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    process.end_by_signals()
    with results.result_folder(Path(sys.argv[1])) as folder:
        (folder / "a").write_text("2")
        with process.signals_deferred():
            print("ready", flush=True)
            time.sleep(float(sys.argv[2]))
            (folder / "late").write_text("written")
            print("written", flush=True)
        time.sleep(60)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_wait_for_the_writer_and_leave_nothing(tmp_path, number):
    with _in_process(_WAITS, tmp_path / "out", 0.5) as process:
        assert process.stdout.readline() == "ready\n"
        process.send_signal(number)
        assert process.stdout.read() == "written\n"
        assert process.wait() != 0
    assert not (tmp_path / "out").exists()


def test_the_next_run_removes_what_a_kill_left(tmp_path):
    with _in_process(_WAITS, tmp_path / "out", 60) as process:
        assert process.stdout.readline() == "ready\n"
        process.kill()
    assert (tmp_path / "out" / ".writing" / "a").exists()
    _write(tmp_path / "out", b="3")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["b", MANIFEST]


@pytest.mark.parametrize("function", ["_lock", "_complete"])
def test_a_signal_before_the_first_file_leaves_nothing(tmp_path, monkeypatch, function):
    begin = getattr(results, function)

    def interrupted(*arguments):
        result = begin(*arguments)
        signal.raise_signal(signal.SIGINT)
        return result

    monkeypatch.setattr(results, function, interrupted)
    with pytest.raises(KeyboardInterrupt), result_folder(tmp_path / "out"):
        pytest.fail("the block is not reached")
    assert not (tmp_path / "out").exists()


def test_a_signal_before_an_earlier_run_is_complete_keeps_its_files(tmp_path, monkeypatch):
    out = tmp_path / "out"
    first = _write(out, a="1", b="1")
    with _in_process(_DIES, out, 2) as process:
        assert process.wait() == 9
    with monkeypatch.context() as patch:
        patch.setattr(results, "_complete", lambda *_: signal.raise_signal(signal.SIGINT))
        with pytest.raises(KeyboardInterrupt), result_folder(out):
            pytest.fail("the block is not reached")
    with pytest.raises(ZeroDivisionError), result_folder(out) as folder:
        _fail(folder)
    check_result(out)
    assert Manifest.read(out).run_id != first
