"""What chooses the torque: learning agents, and the way from batched pendulums to stable-baselines3."""
