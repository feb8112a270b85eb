"""What SSP 1.0 calls things: namespaces and files of the Modelica Association's standard, and annotations.

libcosim and Ecos look for the prefixes as they stand here, not for the namespaces that they stand for.
"""

from __future__ import annotations

NAMESPACES = {
    "ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
    "ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon",
    "ssv": "http://ssp-standard.org/SSP1/SystemStructureParameterValues",
    "ssm": "http://ssp-standard.org/SSP1/SystemStructureParameterMapping",
    "osp": "http://opensimulationplatform.com/SSP/OSPAnnotations",
    "orch": "urn:x-orch:experiment:1",
}
DESCRIPTION = "SystemStructure.ssd"
PARAMETER_SET = "application/x-ssp-parameter-set"
PARAMETER_MAPPING = "application/x-ssp-parameter-mapping"
FMU = "application/x-fmu-sharedlibrary"

OSP = "com.opensimulationplatform"  # annotations that libcosim reads: its step, and a component's own
OURS = "orch.experiment"  # our annotation: what SSP cannot state, as the TOML of an experiment file


def tag(name: str) -> str:
    """ "ssd:System" as lxml writes it."""
    prefix, _, local = name.partition(":")
    return f"{{{NAMESPACES[prefix]}}}{local}"
