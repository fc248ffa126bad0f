import subprocess
import sys

import pytest
from helpers import python

from jaxcell.cli import main
from jaxcell.cli.app import COMMANDS, read
from jaxcell.cli.help import example
from jaxcell.space.motion import RULES


def page(capsys, *args):
    with pytest.raises(SystemExit) as ended:
        main(args)
    assert ended.value.code == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("command", COMMANDS)
def test_a_page_of_help_marks_required_options_and_has_an_example(capsys, command):
    said = page(capsys, *command.split(), "--help")
    usage, _, rest = said.partition("\n")
    assert usage.startswith(f"usage: jaxcell {command} ")
    assert f"Example: {example(COMMANDS[command], command)}" in rest
    for nothing in ("None", "(default: )", "(default: False)"):
        assert nothing not in said
    options = rest.partition("─ options ─")[2]
    # Required options come before options with a default.
    assert "(required)" not in options.partition("(default:")[2]


@pytest.mark.parametrize("command", [name for name in COMMANDS if name != "run"])
def test_an_example_can_be_read(command):
    kind = COMMANDS[command]
    name, found = read(example(kind, command).split()[1:])
    assert name == command
    assert isinstance(found, kind)


def test_lines_of_help_are_as_long_as_the_screen(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "250")
    said = page(capsys, "localize", "--help")
    assert "A robot that slips chooses the angle after which the expected entropy of its be" in said


def test_each_command_is_in_the_list(capsys):
    said = page(capsys, "--help")
    assert all(f"\n  {command}  " in said for command in COMMANDS)
    assert said == page(capsys)


def test_a_group_has_a_page_of_its_own(capsys):
    said = page(capsys, "patrol", "--help")
    assert said.startswith("usage: jaxcell patrol COMMAND")
    assert "patrol map" in said
    assert "localize" not in said


@pytest.mark.parametrize(
    ("args", "meant"),
    [
        (["lokalize", "map.json"], "lokalize; did you mean localize?"),
        (["robot", "chek"], "robot chek; did you mean robot check?"),
        (["patrol"], "patrol; expected one of patrol graph, patrol map"),
        (["xyzzy"], "xyzzy; jaxcell --help lists them"),
    ],
)
def test_a_mistyped_command_is_corrected(capsys, args, meant):
    with pytest.raises(SystemExit) as ended:
        main(args)
    assert ended.value.code == 2
    assert capsys.readouterr().err == f"jaxcell: there is no command {meant}\n"


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
        ("jaxcell patrol ", {"-h", "--help", "graph", "map"}),
        ("jaxcell sweep s", {"status"}),
        ("jaxcell sweep --re", {"--resume"}),
        ("jaxcell sweep status --js", {"--json"}),
        ("jaxcell localize @lab_a --bou", {"--bounce", "--bounces"}),
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


@pytest.mark.parametrize("line", ["localize", "nothing", "groups map.json --bounce many"])
def test_options_that_cannot_be_read_end_with_status_2(capsys, line):
    with pytest.raises(SystemExit) as ended:
        main(line.split())
    assert ended.value.code == 2
    assert capsys.readouterr().out == ""
