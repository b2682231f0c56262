"""Every command on sound files, from the table of commands."""

from collections.abc import Iterator
from pathlib import Path

from tests.studies.fuzz.command_lines import sound_lines
from tests.studies.fuzz.targets import driven_files, sample_files


def sound_commands(work: Path) -> Iterator[tuple[str, list[str]]]:
    """Lay sound files out, and yield what runs on them.

    Parameters
    ----------
    work : Path
        Where the files are laid out.

    Yields
    ------
    label : str
        The command, and what it writes.
    words : list of str
        Its command line, with outputs in the folder in which it runs.
    """
    of_folder = {"sample": sample_files(work), "driven": driven_files(work)}
    for name, content in of_folder.items():
        for file, data in content.items():
            path = work / "sound" / name / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)

    for line in sound_lines():
        name = "driven" if line[0] in ("drive", "replay") else "sample"
        folder = work / "sound" / name
        words = [
            word.removeprefix("{@}/")
            if word.startswith("{@}/out")
            else word.replace("{@}", str(folder))
            for word in line
        ]
        outputs = [word for word in words if word.startswith("out")]
        plan = words[1:2] if words[0] == "plan" else []
        yield " ".join([words[0], *plan, *outputs]), words
