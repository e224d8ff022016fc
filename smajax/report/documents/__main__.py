"""Write the JSON schemas of the result documents: ``python -m smajax.report.documents FOLDER``."""

import sys

from smajax.report.documents.schemas import write_schemas

if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m smajax.report.documents FOLDER")
    print(*write_schemas(sys.argv[1]), sep="\n")
