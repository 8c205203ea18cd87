"""Train a sampler of roadmaps: python scripts/train_lego_sampler.py [ROOT] [--weights FILE].

It trains the sample of models/lego_sampler.py. With --product first it trains the models of
models/pretrained/, whose arguments `mapdata.models.train` describes:

    python scripts/train_lego_sampler.py --product fit --weights FILE
"""

from __future__ import annotations

from mapdata.interrupts import exit_on_interrupt

if __name__ == "__main__":
    exit_on_interrupt()  # before the imports, which take seconds

import sys

from mapdata.models import lego_sampler, train


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; None takes the arguments of the process."""
    words = sys.argv[1:] if arguments is None else arguments
    if words[:1] != ["--product"]:
        lego_sampler.main(arguments)
        return
    if arguments is None:  # Lightning's command line reads the arguments of the process
        del sys.argv[1]
    train.train_lego_sampler(None if arguments is None else words[1:])


if __name__ == "__main__":
    main()
