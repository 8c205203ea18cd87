"""``python -m mapdata``: the command ``mapdata``."""

from mapdata.cli import main

if __name__ == "__main__":
    main()
