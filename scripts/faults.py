"""Puts the faults of tests/faults.toml into a copy of the code, one at a time, and says which ones a
test catches.

    python scripts/faults.py [--list] [--only TEXT …] [--jobs N]

A fault replaces one line of one file. Its test has to fail: an error outside the test, as of an
import, does not count. The checkout is not changed. With `--only`, faults whose file or test
contains one of the texts. The exit status is 1 if a fault survives or does not fit the code.
"""

from __future__ import annotations

import argparse
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

from cablebot_gym.physics.compiling.code_cache import code_folders

ROOT = Path(__file__).resolve().parents[1]
FAULTS = ROOT / "tests" / "faults.toml"
LONGEST = 600.0
"""Time after which a test counts as hanging [s]."""


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A wrong line and the test that catches it."""

    file: str
    line: str
    """The correct line, without its indentation."""
    faulty: str
    test: str
    """The test as pytest names it."""
    why: str = ""

    @property
    def room(self) -> str:
        """Package and room of the file, such as ``cablebot_gym/envs``."""
        path = Path(self.file.removeprefix("baselines/"))
        return "/".join(path.with_suffix("").parts[:2])

    def placed(self, text: str) -> str:
        """The text of the file with the faulty line.

        Raises:
            ValueError: if the correct line is not there exactly once.
        """
        lines = text.split("\n")
        found = [index for index, line in enumerate(lines) if line.strip() == self.line]
        if len(found) != 1:
            raise ValueError(f"its line is {len(found)} times in {self.file}")
        line = lines[found[0]]
        indentation = line[: len(line) - len(line.lstrip())]
        lines[found[0]] = indentation + self.faulty
        return "\n".join(lines)


def read_faults() -> list[Fault]:
    """All faults, ordered by test, so that tests that share compiled code follow each other."""
    faults = [Fault(**data) for data in tomllib.loads(FAULTS.read_text(encoding="utf-8"))["fault"]]
    return sorted(faults, key=lambda fault: fault.test)


def copy_tree(folder: Path) -> None:
    """Copies the files of the checkout that git does not ignore."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    for name in filter(None, names.split("\0")):
        source = ROOT / name
        if source.is_file():
            target = folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, target)


def run_tests(folder: Path, tests: list[str]) -> subprocess.CompletedProcess[str]:
    """Runs tests on the code of a copy, which has compiled code of its own."""
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(map(str, (folder, folder / "baselines"))),
        "NUMBA_CACHE_DIR": str(folder.parent / "compiled"),
        "OMP_NUM_THREADS": "1",
    }
    options = ["-q", "-rfE", "--tb=no", "-p", "no:cacheprovider", "-m", ""]
    if len(tests) == 1:
        options.append("-x")
    return subprocess.run(
        [sys.executable, "-m", "pytest", *options, *tests],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=LONGEST * len(tests),
    )


def write_code(path: Path, text: str) -> None:
    """Writes a module and removes its bytecode: files of equal size and time are confused."""
    path.write_text(text, encoding="utf-8")
    for bytecode in path.parent.glob(f"__pycache__/{path.stem}.*.pyc"):
        bytecode.unlink()


def outcome_of(fault: Fault, folder: Path) -> str:
    """Whether the fault is caught in this copy, in words."""
    path = folder / fault.file
    correct = path.read_text(encoding="utf-8")
    try:
        write_code(path, fault.placed(correct))
        output = run_tests(folder, [fault.test]).stdout
    except ValueError as error:
        return f"stale: {error}"
    except subprocess.TimeoutExpired:
        return "hangs"
    finally:
        write_code(path, correct)
    if "\nFAILED " in output:
        return "caught"
    if "\nERROR " in output:
        return "error outside the test"
    return "survived"


def red_tests(faults: list[Fault], folder: Path) -> list[str]:
    """Lines of pytest about named tests that fail or are missing without any fault."""
    done = run_tests(folder, sorted({fault.test for fault in faults}))
    if done.returncode == 0:
        return []
    lines = (done.stdout + done.stderr).splitlines()
    return [line for line in lines if line.startswith(("FAILED", "ERROR"))] or lines


def run_faults(faults: list[Fault], folders: list[Path]) -> dict[Fault, str]:
    """Outcome of each fault. Each copy of the code has one fault at a time."""
    free: queue.Queue[Path] = queue.Queue()
    for folder in folders:
        free.put(folder)

    def run(fault: Fault) -> str:
        folder = free.get()
        try:
            return outcome_of(fault, folder)
        finally:
            free.put(folder)

    start = time.monotonic()
    outcomes: dict[Fault, str] = {}
    with ThreadPoolExecutor(len(folders)) as pool:
        futures = {pool.submit(run, fault): fault for fault in faults}
        for future in as_completed(futures):
            fault = futures[future]
            outcomes[fault] = future.result()
            print_row(fault, outcomes[fault])
            done = len(outcomes)
            left = (time.monotonic() - start) / done * (len(faults) - done)
            print(f"{done} of {len(faults)}, {left / 60:.1f} min left", file=sys.stderr)
    return outcomes


def print_row(fault: Fault, outcome: str) -> None:
    """Prints one fault."""
    print(f"{outcome:8}  {fault.file}: {fault.faulty}  [{fault.test}]", flush=True)


def print_summary(outcomes: dict[Fault, str]) -> None:
    """Prints the number of faults that are caught by room."""
    total: Counter[str] = Counter()
    caught: Counter[str] = Counter()
    for fault, outcome in outcomes.items():
        total[fault.room] += 1
        caught[fault.room] += outcome == "caught"
    for room in sorted(total):
        print(f"{room}: {caught[room]} of {total[room]} caught")
    print(f"all: {caught.total()} of {total.total()} caught")


def main() -> int:
    """Runs the command; returns its exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--only", nargs="+", default=[""], metavar="TEXT")
    parser.add_argument("--list", action="store_true", help="print the faults and run nothing")
    parser.add_argument("--jobs", type=int, default=1, help="copies of the code that run at once")
    options = parser.parse_args()
    faults = []
    for fault in read_faults():
        if any(text in fault.file or text in fault.test for text in options.only):
            faults.append(fault)
    if not faults:
        parser.error(f"no fault has one of {', '.join(options.only)} in its file or test")
    if options.list:
        for fault in faults:
            print_row(fault, "listed")
        return 0
    with tempfile.TemporaryDirectory() as temporary:
        folders = [Path(temporary, str(job)) for job in range(options.jobs)]
        for folder in folders:
            copy_tree(folder)
        if code_folders()[-1].is_dir():
            shutil.copytree(code_folders()[-1], Path(temporary, "compiled", "cablebot_gym"))
        red = red_tests(faults, folders[0])
        if red:
            print("these tests fail without a fault:", *red, sep="\n")
            return 1
        outcomes = run_faults(faults, folders)
    print_summary(outcomes)
    return 0 if set(outcomes.values()) == {"caught"} else 1


if __name__ == "__main__":
    sys.exit(main())
