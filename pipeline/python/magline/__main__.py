"""The command `magline`: `python -m magline [--parts FILE.py]... ARGUMENTS`."""

import os
import sys
import sysconfig
import traceback
from pathlib import Path

from magline._magline import command
from magline.parts import load_parts, registered

PARTS = "MAGLINE_PARTS"
"""Variable with the files of `--parts`, separated as in `PATH`. Worker processes inherit it."""


HELP = """Option of the Python package, before or after the command:
      --parts FILE.py  Load stages, models, filters and metrics written in Python. May be repeated"""


def main() -> None:
    """Run the command with the arguments of this process and exit with its status.

    ``--parts FILE.py`` loads stages, models, filters and metrics that are written in Python, before
    any other argument is read. Worker processes run the console script `magline` of this
    environment, or ``sys.argv[0]`` if there is no such script. They load the same files.
    """
    files, arguments = split_parts(sys.argv[1:])
    inherited = [file for file in os.environ.get(PARTS, "").split(os.pathsep) if file]
    given = [str(Path(file).resolve()) for file in files]
    files = list(dict.fromkeys([*inherited, *given]))
    for file in files:
        if os.pathsep in file:
            print(f"error: the path given to --parts contains {os.pathsep!r}: {file!r} (move the file)",
                  file=sys.stderr)
            sys.exit(2)
        try:
            load_parts(file)
            registered()
        except Exception:
            traceback.print_exc()
            print(f"error: the parts in {file!r} cannot be loaded (correct the file, or --parts)", file=sys.stderr)
            sys.exit(2)
    if files:
        os.environ[PARTS] = os.pathsep.join(files)
    script = Path(sysconfig.get_path("scripts")) / "magline"
    program = script if script.is_file() else Path(sys.argv[0])
    status = command(program, arguments)
    if arguments in (["--help"], ["-h"]):
        print(f"\n{HELP}")
    sys.exit(status)


def split_parts(arguments: list[str]) -> tuple[list[str], list[str]]:
    """Files of `--parts`, and the other arguments."""
    files, others = [], []
    rest = iter(arguments)
    for argument in rest:
        if argument == "--parts":
            file = next(rest, None)
            if file is None:
                print("error: --parts requires a Python file", file=sys.stderr)
                sys.exit(2)
            files.append(file)
        elif argument.startswith("--parts="):
            files.append(argument.removeprefix("--parts="))
        else:
            others.append(argument)
    return files, others


if __name__ == "__main__":
    main()
