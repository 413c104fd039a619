"""What the tests of environments share."""

import os

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")  # windows of mode human need no screen
