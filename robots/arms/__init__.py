"""Arms of n joints."""
