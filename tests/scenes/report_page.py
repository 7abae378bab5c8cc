"""What the scripts of a report page are given."""

import base64
import json
import re
import zlib

HOSTILE = "<script>alert(1)<\\script><img src=x onerror=alert(1)>, & %2C"
"""A name of a tracker that would run, were it HTML."""


def data_of(page):
    """The data of a page, its HTML, without its moments."""
    (packed,) = re.findall(r'id="page-data">(.*?)</script>', page, re.DOTALL)
    return json.loads(zlib.decompress(base64.b64decode(packed)))


def moments_of(page):
    """The moments of each recording that has a player."""
    return [json.loads(text) for text in re.findall(r'id="moments-\d+">(.*?)</script>', page, re.DOTALL)]
