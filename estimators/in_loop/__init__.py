"""Servos with their controller in the loop: fitted and diagnosed by simulating whole recordings from the goal."""
