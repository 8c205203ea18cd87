"""Compare samplers: python scripts/evaluate_sampler.py --preset dungeon --maps 1000 --seed 77.

`mapdata.models.evaluate` describes the rows.
"""

from __future__ import annotations

from mapdata.interrupts import exit_on_interrupt

if __name__ == "__main__":
    exit_on_interrupt()  # before the imports, which take seconds

from mapdata.cli import run_parsed
from mapdata.models.evaluate import evaluate_samplers


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; None takes the arguments of the process."""
    run_parsed(evaluate_samplers, arguments, root=[])


if __name__ == "__main__":
    main()
