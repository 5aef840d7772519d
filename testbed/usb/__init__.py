"""Emulated USB: a pyusb backend whose devices are emulated boards, so that pyusb and the driver run unchanged."""
