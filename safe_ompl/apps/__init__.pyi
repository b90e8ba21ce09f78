from .cli.program import main as main
from .proven import assert_proven as assert_proven
