"""Generated from proto/monoslam/v1/slam.proto by generate_stubs.py; do not edit."""
