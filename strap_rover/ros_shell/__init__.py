"""What every node shares: parameters, counted topics, health, shutdown; and the exact message conversions."""
