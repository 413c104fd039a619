"""Arms of servos: each joint is simulated in its loop, while the other joints move as measured."""
