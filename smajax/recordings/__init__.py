"""Recordings: measured time series with named channels in SI units.

- ``recording``: the class ``Recording`` (slice, resample, write) and the interpolation of its channels.
- ``read``: reads a file (CSV, MATLAB, Parquet, Excel) and checks it; ``readers`` has one file per format.
- ``column_mapping``: which column of a file is which channel; ``value_checks`` and ``unit_checks``: what cannot be a
    recording.
- ``shared_rows``: holdout recordings that repeat rows of training ones.
- ``datasets``: recordings by name, shipped ones and public ones.

Nothing here imports JAX, so that a bad file is refused at once.
"""

from smajax.recordings.column_mapping import ChannelMap
from smajax.recordings.read import read_recording
from smajax.recordings.recording import Recording

__all__ = ["ChannelMap", "Recording", "read_recording"]
