"""From a recording to clean signals: derivatives, noise, stick."""
