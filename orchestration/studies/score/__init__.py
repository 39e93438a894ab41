"""Controllers compared on one vehicle: the protocol, the score, margins, tuning."""
