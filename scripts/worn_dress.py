"""The pleated dress of ../shared/meshes as another simulator draped it on its mannequin, as two meshes."""

from pathlib import Path

MESHES = Path(__file__).resolve().parents[2] / "shared" / "meshes"
VERTICES = 15656  # of the dress; the mannequin's follow


def write_meshes(folder: Path) -> None:
    """dress.obj (the draped positions with the panels' pattern, groups and stitches) and body.obj in folder."""
    draped = [line for line in (MESHES / "pleated-dress-draped-with-mannequin.obj").open() if line[0] in "vf"]
    points = [line for line in draped if line.startswith("v ")]
    panels = (MESHES / "pleated-dress-panels.obj").read_text().splitlines(keepends=True)
    moved = iter(points[:VERTICES])
    dress = "".join(next(moved) if line.startswith("v ") else line for line in panels)
    (folder / "dress.obj").write_text(dress)
    body = points[VERTICES:]
    for line in draped:
        corners = [int(word.split("/")[0]) for word in line.split()[1:]] if line.startswith("f ") else []
        if corners and min(corners) > VERTICES:
            body.append("f " + " ".join(str(c - VERTICES) for c in corners) + "\n")
    (folder / "body.obj").write_text("".join(body))
