"""The process in which behaviour rules load and call an FMU."""

import os

from fmus.compliance import derivative_rules, lifecycle_rules, state_rules
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import Stage, registered
from fmus.process import Parent

MODULES = (lifecycle_rules, state_rules, derivative_rules)
READY = "ready"


def judge_rules(parent: Parent) -> None:
    """Receive the paths of an FMU and of its folder, then names of rules; send each rule's messages."""
    path, folder = parent.receive()
    os.chdir(folder)  # where the FMU writes files
    rules = {rule.name: rule for rule in registered(Stage.BEHAVIOUR)}
    fmu, probe = FmuFile(path), None
    parent.send(READY)
    while True:
        rule = rules[parent.receive()]
        try:
            probe = probe or Probe(fmu, folder)
            messages = list(rule.check(probe))
        except Exception as error:  # whatever a foreign library makes of a call is a finding
            messages = [str(error) or type(error).__name__]
        parent.send(messages)
