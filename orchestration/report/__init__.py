"""Results as one interactive HTML page, and the live page of a scenario; both need no network."""
