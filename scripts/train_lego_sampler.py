"""Train a sampler of roadmaps: python scripts/train_lego_sampler.py fit --weights FILE.

`mapdata.models.train` describes the arguments.
"""

from __future__ import annotations

from mapdata.interrupts import exit_on_interrupt

if __name__ == "__main__":
    exit_on_interrupt()  # before the imports, which take seconds

from mapdata.models.train import train_lego_sampler


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; None takes the arguments of the process."""
    train_lego_sampler(arguments)


if __name__ == "__main__":
    main()
