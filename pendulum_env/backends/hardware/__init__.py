"""The DM1015B rig: adapters that reach its drive, and around each the same guard, pacing and care."""
