"""`python -m tests.studies.fleet`: processes find their work in a module of another name."""

import sys

from tests.studies.fleet.study import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
