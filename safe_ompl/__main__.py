"""`python -m safe_ompl`: the program `safe-ompl`."""

import sys

from safe_ompl.cli.main import main

sys.exit(main())
