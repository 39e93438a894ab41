"""Places where many runs are made beside this processor: a GPU, a Dask cluster."""
