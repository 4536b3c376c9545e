from .catalogue import entries as entries
from .entry import Entry as Entry
from .finding import Finding as Finding
from .programme import published as published
from .protocols import duration as duration
from .results import committed as committed
from .values import published_value as published_value
