"""The page of the app and the server that hands it out."""
