"""Recordings: measured time series with named channels in SI units.

- ``recording``: the class ``Recording`` (slice, resample, write) and the interpolation of its channels.
- ``read``: reads and checks a file (CSV, JSON, MATLAB, Parquet, Excel, TDMS, ROS bag, MCAP) or a table in memory;
  ``readers`` has one module per format.
- ``read_options``: layout of a file, its clock, and what is done with bad rows; ``bad_rows`` drops them.
- ``sources``: what is taken where a recording is expected; ``recording_checks``: recordings that are read.
- ``column_selection``: columns that are left out or joined; ``column_mapping``: the channel of each other one.
- ``value_checks`` and ``unit_checks``: checks of the numbers; ``traced_values``: refusal of values that JAX traces.
- ``shared_rows``: holdout recordings that repeat rows of training recordings.
- ``datasets``: shipped and public recordings by name.
- ``write``: tables as CSV or Parquet; ``paths``: hints for misspelt paths, and files written completely or not at all.

Nothing here imports JAX, so that a bad file is refused at once.
"""

from smajax.recordings.column_mapping import ChannelMap
from smajax.recordings.read import read_recording, read_recordings
from smajax.recordings.read_options import ReadOptions
from smajax.recordings.recording import Recording
from smajax.recordings.sources import DataFrameLike, RecordingSource, as_source_list

__all__ = [
    "ChannelMap",
    "DataFrameLike",
    "ReadOptions",
    "Recording",
    "RecordingSource",
    "as_source_list",
    "read_recording",
    "read_recordings",
]
