"""Page reference/keys.md: every key of a scenario file, from its JSON schema."""

from orchestration.cli.explain import Section, markdown_table, sections

_HEAD = """\
# Keys of scenario files

Every key of a [scenario file](scenarios.md), from its
[JSON schema](../../orchestration/scenarios/scenario.schema.json). `l1-depth explain` prints the same tables.
Arguments in bold are required; the others show their default value, if they have one."""


def page() -> str:
    """Returns the whole page."""
    tables = [_section(section) for group in sections().values() for section in group]
    return "\n\n".join([_HEAD, *tables]) + "\n"


def _section(section: Section) -> str:
    parts = [f"## {section.title}", section.note, markdown_table(section.headings, section.rows)]
    return "\n\n".join(filter(None, parts))
