"""Values of parameters from data: of a vehicle from logs of dives, of gains from published figures."""
