"""Page and server of the app."""
