# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The documentation: links lead somewhere, what it names exists, examples print what it says."""

import ast
from pathlib import Path
import re

import pytest
import yaml

REPOSITORY = Path(__file__).parents[1]
README = REPOSITORY / 'README.md'
DOCS = sorted((REPOSITORY / 'docs').glob('*.md'))
BENCHMARKS = REPOSITORY / 'benchmarks'
NOTES = [BENCHMARKS / 'README.md', *sorted((BENCHMARKS / 'notes').glob('*.md'))]
PAGES = [README, *DOCS, *NOTES]


def name(page):
    return page.name


def text_of(page):
    return page.read_text(encoding='utf-8')


def without_code(text):
    return re.sub(r'```.*?```', '', text, flags=re.DOTALL)


def anchors(page):
    """Return the anchors of the headings of a page, as GitHub makes them."""
    headings = re.findall(r'^#+ (.*)$', without_code(text_of(page)), re.MULTILINE)
    return {re.sub(r'[^\w -]', '', heading.lower()).replace(' ', '-') for heading in headings}


@pytest.mark.parametrize('page', PAGES, ids=name)
def test_links_lead_somewhere(page):
    for link in re.findall(r'\]\(([^)\s]+)\)', without_code(text_of(page))):
        if '://' in link:
            continue
        path, _, anchor = link.partition('#')
        target = page.parent / path if path else page
        assert target.exists(), link
        assert not anchor or target.suffix != '.md' or anchor in anchors(target), link


def test_the_pages_are_few_short_and_reached_from_the_readme():
    linked = {Path(link).name for link in re.findall(r'\]\((docs/\w+\.md)', text_of(README))}
    assert linked == {page.name for page in DOCS}
    assert len(DOCS) <= 10
    assert len(text_of(README).splitlines()) <= 200
    assert sum(len(text_of(page).splitlines()) for page in DOCS) <= 2600


@pytest.mark.parametrize('page', [README, REPOSITORY / 'docs/library.md'], ids=name)
def test_the_examples_print_what_the_page_says(page, capsys):
    # Not across the end of a block that prints nothing.
    example = r'```python\n((?:(?!```).)*)```\n\n```text\n(.*?)```'
    examples = re.findall(example, text_of(page), re.DOTALL)
    assert examples
    for code, output in examples:
        exec(compile(code, page.name, 'exec'), {})
        assert capsys.readouterr().out == output


def test_commands_are_executables_benchmarks_or_files():
    tree = ast.parse(text_of(REPOSITORY / 'setup.py'))
    strings = [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)]
    own = {text.partition(' = ')[0] for text in strings if ' = dg_localization.' in str(text)}
    for page in (README, *DOCS):
        text = text_of(page)
        for module in re.findall(r'\bbenchmarks(?:\.\w+)+', text):
            path = REPOSITORY / module.replace('.', '/')
            assert path.is_dir() or path.with_suffix('.py').is_file(), module
        for script in re.findall(r'\b(?:docs|test)/[\w/]+\.py', text):
            assert (REPOSITORY / script).is_file(), script
        blocks = ' '.join(re.findall(r'```sh\n(.*?)```', text, re.DOTALL))
        used = set(re.findall(r'ros2 run dg_localization (\w+)', blocks))
        used |= set(re.findall(r'^([a-z]+_[a-z]+)\b', blocks, re.MULTILINE))
        assert used <= own, used - own


def test_parameters_that_the_pages_name_exist():
    (table,) = yaml.safe_load(text_of(REPOSITORY / 'config/localizer.yaml')).values()
    rooms = {room: own for room, own in table['ros__parameters'].items() if isinstance(own, dict)}
    known = {f'{room}.{name}' for room, own in rooms.items() for name in own}
    for page in (README, *DOCS):
        named = re.findall(r'`(\w+\.[a-z_]+)(?::[^`]*)?`', without_code(text_of(page)))
        wrong = {text for text in named if text.partition('.')[0] in rooms and text not in known}
        wrong -= {text for text in wrong if text.endswith(('.py', '.md', '.yaml'))}
        assert not wrong, (page.name, wrong)


def test_words_are_few_and_in_alphabetical_order():
    words = text_of(REPOSITORY / 'docs/development.md').split('\n## Words')[1]
    words = re.findall(r'^\| (.*?) \|', words, re.MULTILINE)[1:]
    words = [word for word in words if not word.startswith('---')]
    assert 20 < len(words) <= 40
    assert [word.lower() for word in words] == sorted(word.lower() for word in words)


@pytest.mark.parametrize('page', ['development.md', 'rigor.md'])
def test_files_that_a_page_names_exist(page):
    package = REPOSITORY / 'dg_localization'
    bases = REPOSITORY, package, package / 'solver', package / 'fleet'
    text = without_code(text_of(REPOSITORY / 'docs' / page))
    named = [found for found in re.findall(r'`([\w./]+/[\w./]*)`', text) if found[0] != '.']
    assert len(named) > 10
    assert [path for path in named if not any((base / path).exists() for base in bases)] == []
