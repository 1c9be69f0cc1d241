"""The demonstration: a simulated fleet, localized over DDS."""
