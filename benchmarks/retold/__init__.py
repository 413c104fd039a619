"""Retold logs: the same machine, moved and logged in other ways; outcomes by row and by motion."""
