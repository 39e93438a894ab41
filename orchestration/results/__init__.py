"""Recordings, their files, metrics, statistics and figures."""
