"""Slave that PythonFMU's binary calls in the FMU of a policy class."""

from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

from fmus.block.own_modules import OwnModules
from fmus.block.policy import PolicyInstance, policy_block
from fmus.block.slave import BlockSlave


class PolicySlave(BlockSlave):
    """A policy class behind PythonFMU's interface; a subclass has its name, and names its module.

    A reset makes a new slave, which imports the modules again.

    module: of the package that the resources hold
    """

    module: ClassVar[str]
    instance_class = PolicyInstance

    def __init__(self, **kwargs: Any) -> None:
        package = self.module.partition(".")[0]
        modules = OwnModules(package, Path(kwargs["resources"], package))
        with modules.present():
            cls = vars(import_module(self.module))[type(self).__name__]
        self.block = policy_block(cls, modules)
        super().__init__(**kwargs)
