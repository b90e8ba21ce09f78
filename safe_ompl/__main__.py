"""`python -m safe_ompl`: the program `safe-ompl`."""

import sys

from safe_ompl.apps import main

sys.exit(main())
