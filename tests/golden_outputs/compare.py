"""Compare everything that the commands print and write of the golden runs with another commit, byte for byte.

``python tests/golden_outputs/compare.py [COMMIT]``: the work tree against COMMIT [HEAD], both in this environment.
For the moving of walls: exit code 0 if no byte has changed, 1 with the first differing line of each output.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
KEPT = ROOT / "build" / "golden_outputs"


def main(arguments: list[str]) -> int:
    """Write both outputs and compare them."""
    commit = _git("rev-parse", "--short=12", arguments[0] if arguments else "HEAD")
    now = outputs_of(ROOT, KEPT / "now")
    script = hashlib.sha256((HERE / "outputs.py").read_bytes()).hexdigest()[:8]
    then = KEPT / f"{commit}-{script}"
    if not then.exists():
        with tempfile.TemporaryDirectory() as folder:
            _git("worktree", "add", "--detach", f"{folder}/tree", commit)
            try:
                outputs_of(Path(folder, "tree"), then)
            finally:
                _git("worktree", "remove", "--force", f"{folder}/tree")
    found = list(changes(then, now))
    sys.stdout.write("".join(f"{text}\n" for text in found) or f"no byte differs from {commit}\n")
    return 1 if found else 0


def outputs_of(tree: Path, folder: Path) -> Path:
    """Write the outputs of a source tree by a process of its own."""
    environment = os.environ | {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    subprocess.run([sys.executable, HERE / "outputs.py", folder], check=True, env=environment, cwd=tree)
    return folder


def changes(then: Path, now: Path) -> list[str]:
    """Each output that has changed, with its first differing line."""
    found = []
    for name in sorted({path.name for folder in (then, now) for path in folder.iterdir()}):
        if not (then / name).exists() or not (now / name).exists():
            found.append(f"{name}: only {'now' if (now / name).exists() else 'then'}")
            continue
        a, b = ((folder / name).read_bytes() for folder in (then, now))
        if a != b:
            lines = (a.splitlines(), b.splitlines())
            row = next(
                (row for row, (x, y) in enumerate(zip(*lines, strict=False)) if x != y), min(map(len, lines))
            )
            old, new = (repr(text[row][:160] if row < len(text) else b"") for text in lines)
            found.append(f"{name}, line {row + 1}:\n  then {old}\n  now  {new}")
    return found


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", "-C", ROOT, *arguments], check=True, capture_output=True, text=True)
    return done.stdout.strip()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
