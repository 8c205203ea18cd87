"""Build a dataset: python scripts/build_shards.py [ROOT] --preset NAME --maps N."""

from mapdata.cli import build_main

if __name__ == "__main__":
    build_main()
