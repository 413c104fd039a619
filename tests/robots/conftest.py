"""What tests of robots share."""

from tests.commands import run_command as run_command
from tests.commands import run_refused as run_refused
