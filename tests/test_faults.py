"""The faults of tests/faults.toml fit the code and the tests."""

import ast

import pytest
from faults import ROOT, read_faults


def problem_of(fault):
    """What keeps a fault from being tried; empty if nothing does."""
    file, _, name = fault.test.partition("::")
    function = name.partition("[")[0]
    try:
        ast.parse(fault.placed((ROOT / fault.file).read_text(encoding="utf-8")))
        tests = (ROOT / file).read_text(encoding="utf-8")
    except (OSError, ValueError, SyntaxError) as error:
        return f"{fault.faulty!r}: {error}"
    if f"def {function}(" not in tests:
        return f"{fault.faulty!r}: no test {fault.test}"
    return ""


@pytest.mark.landing
def test_every_fault_fits_its_file_and_its_test():
    """Excludes faults that nobody can try after a line or a test has changed."""
    problems = [problem_of(fault) for fault in read_faults()]
    assert [problem for problem in problems if problem] == []
