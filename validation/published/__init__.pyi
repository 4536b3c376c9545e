from .catalogue import entries as entries
from .entry import Entry as Entry
from .finding import Finding as Finding
from .programme import published as published
from .results import committed as committed
