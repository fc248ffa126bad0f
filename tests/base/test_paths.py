import os

import pytest

from jaxcell.base.paths import absent, name_in_results, replacing


def test_replaces_a_file(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with replacing(path) as temporary:
        temporary.write_text("new")
        assert path.read_text() == "old"
        assert temporary.suffix == path.suffix
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
@pytest.mark.parametrize("written", [True, False])
def test_leaves_nothing_behind(tmp_path, error, written):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def fail():
        with replacing(path) as temporary:
            if written:
                temporary.write_text("half of")
            raise error

    with pytest.raises(error):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_names_a_missing_folder(tmp_path):
    with (
        pytest.raises(FileNotFoundError, match=r"there is no folder .*nowhere"),
        replacing(tmp_path / "nowhere" / "a.txt"),
    ):
        pass


@pytest.mark.parametrize(
    ("here", "path", "name"),
    [
        ("home/me/work", "maps/a.json", "maps/a.json"),
        ("home/me/work", "./maps/../a.json", "a.json"),
        ("home/me/work", "{root}/home/me/work/maps/a.json", "maps/a.json"),
        ("home/me/work", "{root}/home/me/a.json", "a.json"),
        ("home/me/work", "{root}/home/me/workshop/a.json", "a.json"),
        ("home/me/work", "../secret/a.json", "a.json"),
        ("home/me", "work/a.json", "work/a.json"),
        ("home", "me/work/a.json", "a.json"),
        (".", "{root}/home/you/a.json", "a.json"),
    ],
)
def test_results_do_not_say_where_files_are_kept(tmp_path, monkeypatch, here, path, name):
    (tmp_path / "home" / "me" / "work").mkdir(parents=True)
    monkeypatch.setenv("HOME", str(tmp_path / "home" / "me"))
    monkeypatch.chdir(tmp_path / here)
    assert name_in_results(path.format(root=tmp_path)).split(os.sep) == name.split("/")


def test_only_a_similar_name_is_suggested_for_a_missing_file(tmp_path):
    (tmp_path / "bow.json").touch()
    for name, meant in (
        ("bow.jsn", f"; did you mean {tmp_path / 'bow.json'}?"),
        ("nothere.json", ""),
    ):
        said = f"{tmp_path / name}: there is no such file{meant}"
        assert str(absent(tmp_path / name)) == said
