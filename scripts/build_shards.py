"""Build a dataset: python scripts/build_shards.py [ROOT] --preset NAME --maps N."""

from mapdata.interrupts import exit_on_interrupt

if __name__ == "__main__":
    exit_on_interrupt()  # before the imports, which take seconds

from mapdata.cli import build_main

if __name__ == "__main__":
    build_main()
