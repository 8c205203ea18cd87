"""The entry point of the command ``mapdata``, also as ``python -m mapdata``."""

from mapdata.interrupts import exit_on_interrupt


def main() -> None:
    """Run the command line in a process of its own, and exit with its code."""
    exit_on_interrupt()  # before the slow imports, so that Ctrl-C works during them
    from mapdata.cli import main as run_command_line

    run_command_line()


if __name__ == "__main__":
    main()
