"""The memory card or USB stick of later models and of the TDS2MEM module: files and folders on drive A:.

Names are those of DOS: eight characters, a point and three, in capitals. Source: programmer manual 071-1075-04,
file system commands and events 251 to 258.
"""

import fnmatch
import re

from instrument.simulated.panel.events import Guess, Refusal

ROOT = "A:\\"
CAPACITY = 32 * 1024 * 1024  # bytes
_NAME = re.compile(r"[A-Z0-9_$~!#%&'()@^{}-]{1,8}(\.[A-Z0-9_$~!#%&'()@^{}-]{0,3})?")
_NOT_FOUND, _BAD_NAME, _FULL, _NO_MEDIUM = 256, 257, 254, 252


class MassStorage:
    r"""Files by their whole path, such as ``A:\\ALL0000\\F0000CH1.CSV``."""

    def __init__(self) -> None:
        self.present = True
        self.format()

    def format(self) -> None:
        """Empty it."""
        self._check_present()
        self.files: dict[str, bytes] = {}
        self.folders = {ROOT}
        self.folder = ROOT

    @property
    def free(self) -> int:
        """Bytes that are left."""
        self._check_present()
        return CAPACITY - sum(map(len, self.files.values()))

    def path(self, name: str) -> str:
        """The whole path of a name; Refusal if it cannot be one, or its folder is missing."""
        self._check_present()
        wanted = name.strip().upper().replace("/", "\\")
        if wanted.startswith("\\"):
            wanted = "A:" + wanted
        wanted = wanted if wanted.startswith("A:") else self.folder + wanted
        parts: list[str] = []
        for part in wanted.removeprefix("A:").split("\\"):
            if part == "..":
                parts = parts[:-1]
            elif part not in ("", "."):
                if not _NAME.fullmatch(part.replace("*", "X").replace("?", "X")[:12]) or len(part) > 12:
                    raise Refusal(_BAD_NAME)
                parts.append(part)
        folder = ROOT + "".join(f"{part}\\" for part in parts[:-1])
        if folder not in self.folders:
            raise Refusal(_NOT_FOUND)
        return folder + (parts[-1] if parts else "")

    def write(self, name: str, content: bytes) -> None:
        """Store a file, over one of the same name."""
        path = self.path(name)
        if path == ROOT or f"{path}\\" in self.folders or "*" in path or "?" in path:
            raise Refusal(_BAD_NAME)
        if len(content) - len(self.files.get(path, b"")) > self.free:
            raise Refusal(_FULL)
        self.files[path] = content

    def read(self, name: str) -> bytes:
        """Content of a file."""
        path = self.path(name)
        if path not in self.files:
            raise Refusal(_NOT_FOUND)
        return self.files[path]

    def delete(self, name: str) -> None:
        """Delete the files that a name, perhaps with ``*`` and ``?``, fits."""
        pattern = self.path(name)
        pattern = pattern[:-2] if pattern.endswith("*.*") else pattern
        depth = pattern.count("\\")
        found = [path for path in self.files if fnmatch.fnmatchcase(path, pattern) and path.count("\\") == depth]
        if not found:
            raise Refusal(_NOT_FOUND)
        for path in found:
            del self.files[path]

    def rename(self, old: str, new: str) -> None:
        """Give a file another name or folder."""
        content, target = self.read(old), self.path(new)
        if target in self.files or f"{target}\\" in self.folders:
            raise Refusal(_BAD_NAME)
        del self.files[self.path(old)]
        self.write(new, content)

    def make_folder(self, name: str) -> None:
        """Make a folder in one that exists."""
        path = self.path(name)
        if f"{path}\\" in self.folders or path in self.files or path == ROOT:
            raise Refusal(_BAD_NAME)
        self.folders.add(f"{path}\\")

    def remove_folder(self, name: str) -> None:
        """Remove an empty folder."""
        path = self._folder(name)
        if path == ROOT or any(other != path and other.startswith(path) for other in (*self.files, *self.folders)):
            raise Refusal(Guess.FOLDER_NOT_EMPTY)
        self.folders.discard(path)

    def change_folder(self, name: str) -> None:
        """Look up names without a path there from now on."""
        self.folder = self._folder(name)

    def listing(self) -> list[str]:
        """Names of files and folders in the present folder, in order."""
        self._check_present()
        inside = [path.removeprefix(self.folder).rstrip("\\") for path in (*self.files, *self.folders)
                  if path.startswith(self.folder) and path != self.folder]  # fmt: skip
        return sorted(name for name in inside if "\\" not in name)

    def _folder(self, name: str) -> str:
        path = self.path(name)
        path = path if path.endswith("\\") else f"{path}\\"
        if path not in self.folders:
            raise Refusal(_NOT_FOUND)
        return path

    def _check_present(self) -> None:
        if not self.present:
            raise Refusal(_NO_MEDIUM)
