#!/usr/bin/env python3
"""Tests that `names.py` rejects faulty pages: python3 test_names.py MAGLINE

MAGLINE is the program. Each test changes the text of a dictionary and expects one fault. The files are not changed.
"""

import re
import sys
import unittest
from pathlib import Path

import names

PAGES = sorted((names.DOCS / "coming-from").glob("*.md"))
LISTED = [page for page in PAGES if page.with_suffix(".txt").is_file()]
THESIS = names.DOCS / "coming-from" / "gnadt-2022.md"


class Faults(unittest.TestCase):
    known: names.Names

    @classmethod
    def setUpClass(cls) -> None:
        cls.known = names.Names()

    def check(self, page: Path, old: str = "", new: str = "") -> list[str]:
        """Returns the faults of a page in which `new` replaces the first `old`."""
        text = page.read_text(encoding="utf-8")
        self.assertIn(old, text)
        return names.check(page, text.replace(old, new, 1), self.known)

    def assert_fault(self, faults: list[str], part: str) -> None:
        self.assertTrue(any(part in fault for fault in faults), faults)

    def first_row(self, page: Path) -> str:
        """Returns the first row with an entry of the list of a page."""
        text, known = page.read_text(encoding="utf-8"), names.listed(page)
        at = next(at for at, cells in names.rows(text) if set(names.entries(cells[0], known)) & set(known))
        return text.splitlines()[at - 1] + "\n"

    def test_pages_have_no_fault(self) -> None:
        for page in PAGES:
            with self.subTest(page=page.name):
                self.assertEqual(self.check(page), [])

    def test_a_deleted_row_is_missing(self) -> None:
        for page in LISTED:
            with self.subTest(page=page.name):
                self.assert_fault(self.check(page, self.first_row(page)), " is missing")

    def test_a_repeated_row_occurs_twice(self) -> None:
        for page in LISTED:
            with self.subTest(page=page.name):
                row = self.first_row(page)
                self.assert_fault(self.check(page, row, row + row), " occurs twice")

    def test_an_empty_cell_is_a_fault(self) -> None:
        for page in LISTED:
            with self.subTest(page=page.name):
                row = self.first_row(page)
                empty = re.sub(r"\| [^|]* \|\n$", "| |\n", row)
                self.assertNotEqual(empty, row)
                self.assert_fault(self.check(page, row, empty), "neither a name of magline")

    def test_a_wrong_count_is_a_fault(self) -> None:
        for page in LISTED:
            with self.subTest(page=page.name):
                self.assert_fault(self.check(page, "entries, ", "entries, 1"), "the counts are wrong")

    def test_the_end_of_a_range_must_be_in_the_list(self) -> None:
        self.assert_fault(self.check(THESIS, "(3.33) to (3.43)", "(3.33) to (3.99)"), "(3.99): not in gnadt-2022.txt")

    def test_a_shorter_range_misses_entries(self) -> None:
        faults = self.check(THESIS, "Figures 2-4 to 2-6", "Figures 2-4 to 2-5")
        self.assert_fault(faults, "Figure 2-6 is missing")

    def test_names_must_exist(self) -> None:
        for old, new, part in [
            ("`ekf_adaptive`", "`ekf_adaptve`", "not in the reference"),
            ("`gnadt_2022.toml`", "`gnadt_202.toml`", "no such example or preset"),
            ("`magline map info`", "`magline map inf`", "no such command"),
            ("`magline map plot --track`", "`magline map plot --trak`", "no flag --trak"),
            ("`magline.core_field.igrf`", "`magline.core_field.igf`", "no such function"),
            ("`[[flights.lines]]`", "`[[flights.line]]`", "no such section"),
            ('`model = "pls"` of `fit`', '`modl = "pls"` of `fit`', "no key `modl`"),
            ('`model = "pls"` of `fit`', '`model = "plsr"` of `fit`', "no value plsr"),
            ("`whiten` of `fit`", "`particles` of `fit`", "`particles` is no key of `fit`"),
            ("`low_hz` and `high_hz` of `fit`", "`particles` and `high_hz` of `fit`", "`particles` is no key of `fit`"),
            ("`sets` of `[[flights.lines]]`", "`noise_nt` of `[[flights.lines]]`", "`noise_nt` is no key of"),
            ("figure *Similarity of calibrations*", "figure *Likeness of calibrations*", "no title of a report"),
        ]:
            with self.subTest(new=new):
                self.assert_fault(self.check(THESIS, old, new), part)

    def test_a_page_of_figures_must_mention_the_table(self) -> None:
        faults = self.check(THESIS, "[figures](../../../datasets/examples/NETWORKS.md#gnadt-2022-table-410)",
                            "[figures](../../../datasets/examples/UAV.md)")
        self.assert_fault(faults, "Table 4.10 is not mentioned")

    def test_a_filter_a_model_or_a_metric_without_an_equation(self) -> None:
        for kind, name in (("filter", "crlb"), ("model", "m2d"), ("metric", "cep")):
            text = (names.DOCS / "explanation" / f"{kind}-equations.md").read_text(encoding="utf-8")
            self.assertEqual(names.without_equation(kind, text), [])
            self.assertEqual(names.without_equation(kind, text.replace(f"`{name}`", "")), [name])


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    # `names` reads the program from this list; `unittest` reads its options from another.
    unittest.main(argv=sys.argv[:1])
