"""The benches: `python -m bench NAME [options]`; `python -m bench` lists them."""

import sys

from bench._harness import run

if __name__ == "__main__":
    sys.exit(run(sys.argv[1:]))
