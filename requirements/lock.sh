#!/bin/sh
# Compile the pinned lists again (needs uv): private.txt for the private environment, installed.txt for
# a ROS 2 installation, whose messages were compiled against numpy 1.26 and load with no newer major;
# docs.txt for the site of the manual.
set -eu
cd "$(dirname "$0")"
compile() {
    uv pip compile --quiet --universal --python-version 3.10 --no-annotate --no-header \
        --no-emit-index-url "$@" | grep -v "sys_platform == 'win32'"
}
compile ros.in base.in >private.txt.new
echo "numpy==1.26.4" | compile base.in --constraint - >installed.txt.new
compile docs.in >docs.txt.new
mv docs.txt.new docs.txt
mv private.txt.new private.txt
mv installed.txt.new installed.txt
