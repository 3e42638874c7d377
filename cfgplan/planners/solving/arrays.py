"""numpy, imported at its first use: a small problem is planned with plain lists, sooner than numpy is imported."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy

    np = numpy
else:

    class _ImportedAtFirstUse:
        """Stands for numpy; each attribute that was used is kept, so that later uses cost no call."""

        def __getattr__(self, name: str) -> Any:
            import numpy

            found = getattr(numpy, name)
            setattr(self, name, found)
            return found

    np = _ImportedAtFirstUse()
