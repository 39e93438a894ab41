"""Controllers compared on one vehicle: the protocol, the score, its tables and page, tuning."""
