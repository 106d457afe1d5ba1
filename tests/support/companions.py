"""What the companions of the tests serve."""

import time


def reversed_bytes(request):
    return request()[::-1]


def fails(request):
    raise RuntimeError(request())


def sleeps(request):
    request()
    time.sleep(60)
    return b""
