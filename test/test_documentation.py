# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The documentation: its links lead somewhere, and its examples print what it says."""

from pathlib import Path
import re

import pytest

REPOSITORY = Path(__file__).parents[1]
README = REPOSITORY / 'README.md'
PAGES = [README, *sorted((REPOSITORY / 'docs').glob('*.md'))]
NOTES = sorted((REPOSITORY / 'benchmarks').rglob('*.md'))


def name(page):
    return page.name


def without_code(text):
    return re.sub(r'```.*?```', '', text, flags=re.DOTALL)


def anchors(page):
    """Return the anchors of the headings of a page, as GitHub makes them."""
    headings = re.findall(
        r'^#+ (.*)$', without_code(page.read_text(encoding='utf-8')), re.MULTILINE
    )
    return {re.sub(r'[^\w -]', '', heading.lower()).replace(' ', '-') for heading in headings}


@pytest.mark.parametrize('page', [*PAGES, *NOTES], ids=name)
def test_links_lead_somewhere(page):
    links = re.findall(r'\]\(([^)\s]+)\)', without_code(page.read_text(encoding='utf-8')))
    for link in links:
        if '://' in link:
            continue
        path, _, anchor = link.partition('#')
        target = page.parent / path if path else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_every_page_is_reached_from_the_readme():
    linked = re.findall(r'\]\((docs/\w+\.md)', README.read_text(encoding='utf-8'))
    assert {page.name for page in PAGES[1:]} <= {Path(link).name for link in linked}


def test_the_readme_is_short():
    assert len(README.read_text(encoding='utf-8').splitlines()) <= 250


@pytest.mark.parametrize('page', [README, REPOSITORY / 'docs/solver.md'], ids=name)
def test_the_examples_print_what_the_page_says(page, capsys):
    text = page.read_text(encoding='utf-8')
    # Not across the end of a block that prints nothing.
    example = r'```python\n((?:(?!```).)*)```\n\n```text\n(.*?)```'
    examples = re.findall(example, text, re.DOTALL)
    assert examples
    for code, output in examples:
        exec(compile(code, page.name, 'exec'), {})
        assert capsys.readouterr().out == output


def test_the_glossary_is_in_alphabetical_order():
    text = (REPOSITORY / 'docs/glossary.md').read_text(encoding='utf-8')
    for part in text.split('\n## ')[1:]:
        words = re.findall(r'^\| ([a-z].*?) \|', part, re.MULTILINE)[1:]
        assert len(words) > 40
        assert words == sorted(words)


def test_files_that_the_development_page_names_exist():
    text = (REPOSITORY / 'docs/development.md').read_text(encoding='utf-8')
    names = re.findall(r'`([\w./]+/[\w./]*)`', without_code(text))
    bases = (REPOSITORY, REPOSITORY / 'dg_localization')
    named = [name for name in names if not name.startswith('..')]
    assert len(named) > 20
    assert [name for name in named if not any((base / name).exists() for base in bases)] == []
