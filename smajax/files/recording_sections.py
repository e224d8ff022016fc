"""Text of the sections ``[recording]`` and ``[channels]`` with which a rig reads a file as it is."""

from smajax.files.channel_settings import ChannelSettings
from smajax.recordings.read_options import ReadOptions


def sections_text(options: ReadOptions, channels: ChannelSettings) -> str:
    """Return the sections as TOML, with one line for each column; empty where a file needs neither.

    Args:
        options: Options of reading.
        channels: Columns of the channels, and those that are left out.
    """
    import tomlkit  # slow to import, and not needed to read a file

    document = tomlkit.document()
    layout = options.table()
    if layout:
        section = tomlkit.table()
        for key, value in layout.items():
            section[key] = value
        document["recording"] = section
    columns = {key: value for key, value in channels.table().items() if value is not None}
    if columns:
        section = tomlkit.table()
        for key, value in columns.items():
            if not isinstance(value, dict):
                section[key] = value
                continue
            line = tomlkit.inline_table()
            line.update({k: v for k, v in value.items() if v is not None and (k, v) != ("unit", "1")})
            section[key] = line
        document["channels"] = section
    return tomlkit.dumps(document)
