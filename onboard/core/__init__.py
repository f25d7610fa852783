"""Types that everything shares: geometry, sensors, messages, configuration, errors."""
