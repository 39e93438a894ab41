"""The GUID of an FMU, which follows from names and contents of its members."""

import hashlib
import uuid

# Placeholders of the GUID, and of a part of it in Python names: the GUID follows from the members that
# contain it, so it is known after them.
GUID, GUID_IN_NAMES = "GUID-of-this-FMU", "GUID_of_this_FMU"


def with_guid(members: dict[str, bytes], recipe: str = "") -> tuple[str, dict[str, bytes]]:
    """Returns the GUID of members and recipe, and the members with the GUID in place of the placeholders."""
    digest = hashlib.sha256(recipe.encode())
    for name, data in sorted(members.items()):
        digest.update(hashlib.sha256(name.encode()).digest() + hashlib.sha256(data).digest())
    guid = str(uuid.uuid5(uuid.NAMESPACE_OID, digest.hexdigest()))
    for placeholder, text in ((GUID, guid), (GUID_IN_NAMES, guid.replace("-", "")[:16])):
        members = {
            name.replace(placeholder, text): data.replace(placeholder.encode(), text.encode())
            for name, data in members.items()
        }
    return guid, members
