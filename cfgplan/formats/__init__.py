"""File formats: environment files in YAML, JSON and the paper's XML, and plan files, and importers."""

from cfgplan.formats.assembly import build
from cfgplan.formats.document import Document, read_declared, read_document
from cfgplan.formats.dump import as_xml, as_yaml, dump_yaml, plain_environment
from cfgplan.formats.environment_file import EnvironmentFile
from cfgplan.formats.fields import environment_schema
from cfgplan.formats.places import Place
from cfgplan.formats.plan_file import dump_plan, load_plan, read_run_plan
from cfgplan.formats.tags import TagVocabulary
from cfgplan.formats.wsc import read_wsc, wsc_texts
from cfgplan.formats.wsc_files import unread
from cfgplan.formats.xml_dump import dump_xml

__all__ = [
    "Document",
    "EnvironmentFile",
    "Place",
    "TagVocabulary",
    "as_xml",
    "as_yaml",
    "build",
    "dump_plan",
    "dump_xml",
    "dump_yaml",
    "environment_schema",
    "load_plan",
    "plain_environment",
    "read_declared",
    "read_document",
    "read_run_plan",
    "read_wsc",
    "unread",
    "wsc_texts",
]
