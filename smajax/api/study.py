"""Base class of the results of studies: a document, predictions, and the files that ``save`` writes."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from smajax.arguments import as_path
from smajax.errors import InputError
from smajax.files.documents import to_json
from smajax.files.rig_file import Rig, parse_rig
from smajax.report.documents import write_result
from smajax.report.prediction import Series, read_predictions, write_predictions
from smajax.report.rebuild import build_page
from smajax.report.summaries import summarise

if TYPE_CHECKING:
    import plotly.graph_objects

# Content of a file, or the function that writes it to a path.
FileContent = bytes | Callable[[Path], object]

PREDICTIONS = "prediction.csv"
REPORT = "report.html"


def interval_of(entry: Mapping[str, Any]) -> tuple[float, float] | None:
    """Return the 95 % interval of an entry of a document; ``None`` where an end is not determined."""
    low, high = entry["lower95"], entry["upper95"]
    return None if low is None or high is None else (low, high)


@dataclasses.dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Study:
    """Result of a study.

    Attributes:
        document: The result document, as ``save`` writes it.
        series: Measured and modelled channels of each recording, as in prediction.csv.
        run: Record of the run: versions, machine, timings, exit code.
        files: Content of the other files of the result folder by name.
        reason: Why the study did not succeed; empty if it did.
        note: Sentence on anything else that the user should know.
    """

    command: ClassVar[str]
    document_name: ClassVar[str]

    document: Mapping[str, Any]
    series: tuple[Series, ...] = ()
    run: Mapping[str, Any]
    files: Mapping[str, FileContent]
    reason: str = ""
    note: str = ""

    @property
    def exit_code(self) -> int:
        """Exit code of the command: 0 done, 3 failed numerics, 130 stopped with the best result so far."""
        return int(self.run["exit_code"])

    @property
    def success(self) -> bool:
        """Whether the study succeeded; ``reason`` says why it did not."""
        return self.exit_code == 0

    @property
    def data(self) -> Any:
        """Data of figure and page: the predictions."""
        return self.series

    def summary(self, folder: str = "") -> str:
        """Return the summary in words and tables.

        Args:
            folder: Result folder that the last line names; empty for none.
        """
        return summarise(self.command, self.document, folder)

    def plot(self) -> "plotly.graph_objects.Figure":
        """Return the main figure of the study; ``plot().show()`` displays it."""
        from smajax.report.result_figures import FIGURES

        return FIGURES[self.command](self.document, self.data)

    def save(self, folder: str | Path, *, argv: Sequence[str] = ()) -> Path:
        """Write the result folder, completely or not at all.

        Args:
            folder: The folder; a former result of smajax there is replaced.
            argv: Command line for the record of the run.

        Returns:
            The folder.

        Raises:
            InputError: If the folder holds files that smajax did not write, or cannot be written.
        """
        folder = as_path("save", "folder", folder, "the path of a result folder")
        run = {**self.run, "argv": list(argv)}
        if self.reason and self.document_name != "run.json":  # a simulation has it as its text
            run["reason"] = self.reason
        write_result(folder, run, partial(self._fill, run))
        return folder

    def _fill(self, run: Mapping[str, Any], folder: Path) -> None:
        """Write all files except run.json."""
        for name, content in self.files.items():
            if isinstance(content, bytes):
                (folder / name).write_bytes(content)
            else:
                content(folder / name)
        if self.document_name != "run.json":
            (folder / self.document_name).write_text(to_json(self.document), "utf-8")
        data = self.data
        if self.series:
            write_predictions(folder / PREDICTIONS, self.series)
            # The table is read back, so that `smajax report` makes the same page.
            data = read_predictions(folder / PREDICTIONS)
        rig = self.file_text("rig.toml") if "rig.toml" in self.files else ""  # thermal cycles have none
        (folder / REPORT).write_text(build_page(self.command, self.document, data, run, rig), "utf-8")

    def file_text(self, name: str) -> str:
        """Return the text of a file of the study.

        Args:
            name: Name of the file.

        Raises:
            InputError: If the study has no such text.
        """
        content = self.files.get(name)
        if not isinstance(content, bytes):
            raise InputError(f"this study has no {name}: it has {', '.join(self.files)}")
        return content.decode("utf-8-sig")

    def _rig(self, name: str) -> Rig:
        """The rig of a file of the study."""
        return parse_rig(self.file_text(name), name)

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.headline()}>"

    def headline(self) -> str:
        """Return the beginning of the summary in words."""
        words = self.document.get("summary") or self.summary()
        return str(words).partition("\n\n")[0].replace("\n", " ")

    def _repr_html_(self) -> str:
        """Representation in notebooks."""
        from smajax.report.notebook import notebook_html  # the pages of all commands

        return notebook_html(self.command, self.document)
