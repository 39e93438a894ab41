"""Recordings, their files, metrics and figures."""
