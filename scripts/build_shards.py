"""Build a dataset: python scripts/build_shards.py [ROOT] --maps N --seed S --preset NAME
--shard-size K --workers W.
"""

from mapdata.cli import build_main

if __name__ == "__main__":
    build_main()
