"""Slave that PythonFMU's binary calls in the FMU of a policy class."""

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar

from fmus.block.policy import PolicyInstance, policy_block
from fmus.build.slave import BlockSlave

_SHARED = ("fmus", "pythonfmu")  # packages of the FMU that read none of its files


class PolicySlave(BlockSlave):
    """A policy class behind PythonFMU's interface; a subclass has its name, and names its module.

    module: of the package that the resources hold
    """

    module: ClassVar[str]
    instance_class = PolicyInstance

    def __init__(self, **kwargs: Any) -> None:
        self.block = policy_block(vars(own_module(self.module, kwargs["resources"]))[type(self).__name__])
        super().__init__(**kwargs)


def own_module(name: str, resources: str) -> ModuleType:
    """Returns a module of an instance's own, loaded from its resources with all that it imports there.

    The module of another instance reads its files from a folder that goes when that instance ends.
    """
    top = name.partition(".")[0]
    package, folder = import_module(top), str(Path(resources, top))
    if package.__path__[0] != folder:
        package.__path__[:] = [folder]
        for loaded in [loaded for loaded in sys.modules if loaded.startswith(f"{top}.")]:
            if (part := loaded.split(".")[1]) not in _SHARED:
                del sys.modules[loaded]
                vars(package).pop(part, None)
    return import_module(name)
