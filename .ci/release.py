"""One archive for users without Python: python .ci/release.py [--out FILE.zip]

fmus/ ssp/                          as downloads.py writes them, for all platforms
documentation/index.html            the site of docs/
README.txt LICENSE SHA256SUMS       what is where, the licence, `sha256sum --check SHA256SUMS`

"""

import argparse
import hashlib
import tempfile
from importlib.metadata import version
from pathlib import Path

import downloads

from fmus.files import write_archive

ROOT = Path(__file__).parent.parent
README = """l1-depth {version}

Extended L1 adaptive depth control of an underwater vehicle (Maalouf, Chemori and Creuze, NOLCOS 2013)
as FMUs of FMI 2.0 and 3.0 for 64-bit Windows, Linux (x86_64, ARM) and macOS (x86_64, ARM).

documentation/index.html   start here: a page on importing for each tool, theory, reference
fmus/                      all FMUs; each holds its own documentation and C sources
ssp/                       the closed loop as an SSP 1.0 package
SHA256SUMS                 checksums of all files: sha256sum --check SHA256SUMS
LICENSE                    MIT
"""


def write(archive: Path) -> None:
    """Make everything and pack it into one folder of a zip file; equal content gives equal bytes."""
    with tempfile.TemporaryDirectory() as working:
        folder = Path(working)
        downloads.make(folder)
        site = [
            "--config-file",
            str(ROOT / ".ci" / "mkdocs.yml"),
            "--site-dir",
            str(folder / "documentation"),
        ]
        command = ["mkdocs", "build", "--strict", "--quiet", *site]
        downloads.run(*command, folder=ROOT, L1_DEPTH_DOWNLOADS=str(folder))
        members = {
            path.relative_to(folder).as_posix(): path.read_bytes()
            for path in sorted(folder.rglob("*"))
            if path.is_file()
        }
    members["LICENSE"] = (ROOT / "LICENSE").read_bytes()
    members["README.txt"] = README.format(version=version("l1-depth")).encode()
    sums = [f"{hashlib.sha256(content).hexdigest()}  {name}\n" for name, content in members.items()]
    members["SHA256SUMS"] = "".join(sums).encode()
    write_archive(archive, {f"{archive.stem}/{name}": content for name, content in members.items()})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Write one archive for users without Python.")
    parser.add_argument(
        "--out", type=Path, default=Path(f"l1-depth-{version('l1-depth')}.zip"), metavar="FILE"
    )
    target = parser.parse_args().out.absolute()
    write(target)
    print(target)
