"""What came out: recordings, their files, metrics, figures."""
