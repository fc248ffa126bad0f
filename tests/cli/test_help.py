import re
import subprocess
import sys
from importlib import metadata

import pytest
from helpers import python

from jaxcell.cli import main
from jaxcell.cli.app import COMMANDS, read
from jaxcell.cli.help import example
from jaxcell.space.motion import RULES
from jaxcell.study.parameters import conditions, parameters


def page(capsys, *args):
    with pytest.raises(SystemExit) as ended:
        main(args)
    assert ended.value.code == 0
    return capsys.readouterr().out


def panels(said):
    """The lines under each heading of a page, by the heading."""
    title = r"^[^\w\n]*(options|positional arguments|[\w ,]+\?)[^\w\n]*$"
    _, *parts = re.split(title, said, flags=re.MULTILINE)
    return dict(zip(parts[::2], parts[1::2], strict=True))


@pytest.mark.parametrize("command", COMMANDS)
def test_a_page_of_help_marks_required_options_and_has_an_example(capsys, command):
    said = page(capsys, *command.split(), "--help")
    usage, _, rest = said.partition("\n")
    assert usage.startswith(f"usage: jaxcell {command} ")
    assert f"Example: {example(COMMANDS[command], command)}" in rest.replace(" \\\n ", "")
    for nothing in ("None", "(default: )", "(default: False)"):
        assert nothing not in said
    # Required options come before options with a default.
    assert "(required)" not in panels(said)["options"].partition("(default:")[2]


@pytest.mark.parametrize("command", COMMANDS)
def test_the_first_panel_of_options_has_at_most_12(capsys, command):
    options = panels(page(capsys, *command.split(), "--help"))["options"]
    assert len(re.findall(r"^(?:│ |  )--\w", options, re.MULTILINE)) <= 12


@pytest.mark.parametrize(("command", "columns"), [("drift", 80), ("export", 60), ("groups", 80)])
def test_no_row_of_a_page_is_empty(monkeypatch, capsys, command, columns):
    monkeypatch.setenv("COLUMNS", str(columns))
    assert not re.findall(r"^│ *│$", page(capsys, command, "--help"), re.MULTILINE)


@pytest.mark.parametrize("command", COMMANDS)
def test_an_option_has_at_most_two_conditions(command):
    for name, alternatives in conditions(COMMANDS[command]).items():
        assert sum(len(each.values) for each in alternatives) <= 2, name


@pytest.mark.parametrize("command", COMMANDS)
def test_headings_have_options_of_the_command(command):
    kind = COMMANDS[command]
    for base in kind.__mro__:
        for names in vars(base).get("headings", {}).values():
            assert set(names) <= parameters(kind).keys()


@pytest.mark.parametrize("command", [name for name in COMMANDS if name != "run"])
def test_an_example_can_be_read(command):
    kind = COMMANDS[command]
    name, found = read(example(kind, command).split()[1:])
    assert name == command
    assert isinstance(found, kind)


def test_help_with_the_name_of_a_command_prints_its_page(capsys):
    assert page(capsys, "help", "patrol", "map") == page(capsys, "patrol", "map", "--help")


@pytest.mark.parametrize("word", ["-V", "--version"])
def test_the_version_is_that_of_the_package(capsys, word):
    assert main([word]) == 0
    assert capsys.readouterr().out == f"jaxcell {metadata.version('jaxcell')}\n"


def test_lines_of_help_are_as_long_as_the_screen(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "250")
    said = page(capsys, "localize", "--help")
    assert (
        "Build the localization filter of a map, or the policy of a robot that chooses among b"
        in said
    )


@pytest.mark.parametrize("width", [60, 80, 120])
@pytest.mark.parametrize("words", ["--help", "localize --help", "navigate anywhere --help"])
def test_no_line_of_help_is_longer_than_the_screen(capsys, monkeypatch, width, words):
    monkeypatch.setenv("COLUMNS", str(width))
    assert max(map(len, page(capsys, *words.split()).splitlines())) <= width


@pytest.mark.parametrize("command", COMMANDS)
def test_headings_are_questions(capsys, command):
    own = panels(page(capsys, *command.split(), "--help")).keys()
    assert all(heading.endswith("?") for heading in own - {"options", "positional arguments"})
    headed = [
        names for base in COMMANDS[command].__mro__ for names in vars(base).get("headings", {})
    ]
    assert set(headed) <= own


def test_each_command_is_in_the_list(capsys):
    said = page(capsys, "--help")
    assert all(f"\n  {command}  " in said for command in COMMANDS)
    assert said == page(capsys) == page(capsys, "help")


@pytest.mark.parametrize("words", [["patrol", "--help"], ["help", "patrol"]])
def test_a_group_has_a_page_of_its_own(capsys, words):
    said = page(capsys, *words)
    assert said.startswith("usage: jaxcell patrol COMMAND")
    assert "patrol map" in said
    assert "localize" not in said


@pytest.mark.parametrize(
    ("args", "meant"),
    [
        (["lokalize", "map.json"], "lokalize; did you mean localize?"),
        (["robot", "chek"], "robot chek; did you mean robot check?"),
        (["patrol", "grapf"], "patrol grapf; did you mean patrol graph?"),
        (["xyzzy"], "xyzzy; jaxcell --help lists them"),
    ],
)
def test_a_mistyped_command_is_corrected(capsys, args, meant):
    with pytest.raises(SystemExit) as ended:
        main(args)
    assert ended.value.code == 2
    assert capsys.readouterr().err == f"jaxcell: there is no command {meant}\n"


def test_a_group_alone_is_an_error_that_lists_its_commands(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["patrol"])
    assert ended.value.code == 2
    assert (said := capsys.readouterr()).out == ""
    assert "patrol map Patrol a map" in " ".join(said.err.split())


def test_options_may_be_written_with_underscores(capsys):
    _, found = read(["localize", "@lab_a", "--bounce", "90", "--robot_radius=0.1"])
    assert found.robot_radius == 0.1


@pytest.fixture(scope="module")
def completions(tmp_path_factory):
    """Return the proposals of Bash for the last word of a line, in a folder with one file."""
    folder = tmp_path_factory.mktemp("shell")
    (folder / "my_map.json").touch()
    script, _ = python("-m", "jaxcell", "--tyro-print-completion", "bash")
    (folder / "jaxcell.bash").write_text(script)

    def proposed(line):
        words = line.split(" ")
        program = f"""
. ./jaxcell.bash
COMP_WORDS=({" ".join(f"'{word}'" for word in words)}) COMP_CWORD={len(words) - 1}
_jaxcell jaxcell '{words[-1]}' '{words[-2]}'
echo "${{#COMPREPLY[@]}} ${{COMPREPLY[*]}}"
complete -p jaxcell
"""
        command = ["bash", "--norc", "-c", program]
        run = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
        assert run.stderr == ""
        found, registered = run.stdout.splitlines()
        assert registered == "complete -o default -F _jaxcell jaxcell"
        count, *found = found.split()
        assert int(count) == len(found)
        return set(found)

    return proposed


@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ("jaxcell lo", {"localize"}),
        ("jaxcell patrol ", {"-h", "--help", "evaluate", "graph", "guard", "map"}),
        ("jaxcell sweep s", {"status"}),
        ("jaxcell sweep --re", {"--resume"}),
        ("jaxcell sweep status --js", {"--json"}),
        ("jaxcell localize @lab_a --bou", {"--bounce"}),
        ("jaxcell localize @lab_a --collision ", set(RULES)),
        ("jaxcell groups @lab_a --out my", {"my_map.json"}),
        # Bash proposes files itself.
        ("jaxcell localize my", set()),
    ],
)
def test_a_shell_completes_commands_options_and_choices(completions, line, wanted):
    assert completions(line) == wanted


def test_a_shell_completes_each_command(completions):
    assert {name.split()[0] for name in COMMANDS} <= completions("jaxcell ")


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_have_a_script_too(capsys, shell):
    with pytest.raises(SystemExit) as ended:
        main(["--tyro-print-completion", shell])
    assert not ended.value.code
    assert "_tyro_jaxcell" in capsys.readouterr().out


def test_help_into_a_closed_pipe_is_quiet():
    command = [sys.executable, "-m", "jaxcell", "--help"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as run:
        run.stdout.close()
        assert run.stderr.read() == b""


def test_no_page_of_help_imports_a_slow_package():
    code = (
        "import sys, jaxcell.cli\n"
        f"for line in {[name.split() for name in COMMANDS]!r} + [[]]:\n"
        "    try: jaxcell.cli.main([*line, '--help'])\n"
        "    except SystemExit as end: assert end.code == 0\n"
        "slow = {'jax', 'numpy', 'xarray', 'rerun', 'shapely', 'zarr'}\n"
        "assert not slow & sys.modules.keys(), slow & sys.modules.keys()"
    )
    python("-c", code)
