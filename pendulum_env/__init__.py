"""What produces measurements of a pendulum: physics, recordings, excitation and backends."""
