"""The command `magline`: `python -m magline ARGUMENTS`."""

import sys
import sysconfig
from pathlib import Path

from magline._magline import command


def main() -> None:
    """Run the command with the arguments of this process and exit with its status.

    Worker processes run the console script `magline` of this environment, or ``sys.argv[0]`` if
    there is no such script.
    """
    script = Path(sysconfig.get_path("scripts")) / "magline"
    program = script if script.is_file() else Path(sys.argv[0])
    sys.exit(command(program, sys.argv[1:]))


if __name__ == "__main__":
    main()
