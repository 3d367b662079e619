#!/bin/bash
# Installs the packages of /packages in a fresh Debian, uses them, and purges them: a line that
# begins with PASS per test. `cargo xtask test install` runs this as root in a root that mmdebstrap
# has made, with network, HAL and processes of its own once the packages are there.
#
# /packages/mill is the example mill, with what runs a machine without a screen.
set -euo pipefail
export DEBIAN_FRONTEND=noninteractive HOME=/root LC_ALL=C.UTF-8
BOARD=127.0.0.1:1234
EXAMPLES=/usr/share/linuxcnc/aux_examples

pass() { echo "PASS $1"; }

# What the packages are made with, and what an image is made with.
no_build_tools() {
    local tool
    for tool in rustc cargo yosys nextpnr-ecp5 verilator; do
        if command -v "$tool"; then
            echo "$tool is installed"
            return 1
        fi
    done
}

install() {
    useradd --create-home machinist
    apt-get update -qq
    apt-get install -y -qq --no-install-recommends /packages/*.deb
    # Every file of ours, for the end.
    dpkg -L $(ours) | sort -u > /tmp/ours
    pass "apt installs the packages and LinuxCNC"
    no_build_tools
    pass "nothing that builds Rust or FPGA images is installed"
}

ours() { dpkg-query -W -f '${Package}\n' 'ferrocnc*'; }

programs() {
    [[ $(ferrocnc --version) == "ferrocnc "* ]]
    ferrocnc-sim --version
    ferrocnc config check /usr/share/ferrocnc/boards/mill6.toml
    pass "the programs start, and read a board file of the package"
    local page
    for page in ferrocnc ferrocnc-job-send ferrocnc-sim ferrocnc-twin "9 ferrocnc"; do
        man -w $page
        # groff's warnings.
        [[ -z $(man --warnings $page 2>&1 > /dev/null) ]]
    done
    man 9 ferrocnc | grep -q 'stepgen.<nn>.position-cmd (float in)'
    pass "man finds the pages, and groff warns of nothing"
    # As the shell does after `ferrocnc des` and the tab key.
    . /usr/share/bash-completion/completions/ferrocnc
    COMP_WORDS=(ferrocnc des) COMP_CWORD=1
    _ferrocnc ferrocnc des ferrocnc
    [[ ${COMPREPLY[*]} == describe ]]
    pass "bash completes a command"
}

# The board that LinuxCNC drives: the twin.
board() {
    ferrocnc-sim --backend model --board mill6 --udp $BOARD "$@" > /tmp/sim.log 2>&1 &
    SIM=$!
    timeout 60 sh -c 'until grep -q ^ready /tmp/sim.log; do sleep 0.1; done'
}

# LinuxCNC refuses to run as root.
machinist() { runuser --user machinist -- env HOME=/home/machinist "$@"; }

no_board() {
    kill $SIM
    wait $SIM || true
}

hal() {
    board --mode free
    ferrocnc describe $BOARD
    pass "the tool describes the twin"
    cat > /tmp/loaded.hal <<HAL
loadrt threads name1=servo-thread period1=1000000
loadrt ferrocnc boards=$BOARD
addf ferrocnc.0.read servo-thread
addf ferrocnc.0.write servo-thread
# 100 ms: a busy computer answers late.
setp ferrocnc.0.packet-read-timeout 100000000
start
loadusr -w sleep 1
show pin ferrocnc.0.link.up
show pin ferrocnc.0.packet-error-total
HAL
    machinist halrun /tmp/loaded.hal | tee /tmp/loaded
    grep -q 'bit .*TRUE  *ferrocnc.0.link.up' /tmp/loaded
    pass "loadrt ferrocnc finds the module, its pins have the twin's values"
    no_board
}

# All samples are where the picker looks, with every file that their INI files name.
samples() {
    local folder name
    [[ $(linuxcnc_var LINUXCNC_AUX_EXAMPLES) == "$EXAMPLES" ]]
    for name in lathe mill plasma plotter router; do
        folder=$EXAMPLES/ferrocnc-$name
        # Nothing would change: the files are those of the tool that is installed.
        (cd "$folder" && ferrocnc machine write --twin --dry-run) | grep -qx 'nothing changes'
    done
    pass "the samples are where the picker looks, and are the tool's"
}

# Without a screen, with a recording that says that time passes.
headless() {
    sed -i 's#^DISPLAY = .*#DISPLAY = ./display.py#; s/^COMM_TIMEOUT = .*/COMM_TIMEOUT = 60.0/' "$1"
    cat > "$(dirname "$1")/custom.hal" <<HAL
loadrt sampler depth=20000 cfg=ffsffsffs
addf sampler.0 servo-thread
HAL
}

without_a_card() {
    local mill=/home/machinist/linuxcnc/configs/ferrocnc-mill
    # The picker makes such a copy.
    machinist mkdir -p "$(dirname $mill)"
    machinist cp -r $EXAMPLES/ferrocnc-mill $mill
    cp /packages/mill/{display,headless}.py $mill
    chmod +x $mill/display.py
    headless $mill/mill-twin.ini
    echo 'G21 G90 G0 X10 Y20 M2' > /tmp/program.ngc
    machinist /packages/mill/run.py --board $BOARD --lockstep --out /home/machinist/twin \
        --config $mill --ini mill-twin.ini --program /tmp/program.ngc
    # What has ended and waits for its parent has no command. The brackets: not this grep.
    if grep -al '[f]errocnc-' /proc/[0-9]*/cmdline 2> /dev/null; then
        return 1
    fi
    pass "the mill without a card: LinuxCNC starts its board, homes it, and ends both"
}

example() {
    board --mode lockstep
    machinist /packages/mill/run.py --board $BOARD --out /home/machinist/ran --lockstep
    no_board
    pass "LinuxCNC homes the example mill and runs its program on the twin"
}

purge() {
    apt-get purge -y -qq $(ours)
    [[ -z $(ours) ]]
    local left=()
    while read -r path; do
        # A folder with other files is another package's.
        if [[ -f $path || -L $path ]] || [[ -d $path && -z $(ls -A "$path") ]]; then
            left+=("$path")
        fi
    done < /tmp/ours
    # man keeps the pages that it has shown in a cache of its own, and a copy of a sample is the
    # user's.
    left+=($(find / -xdev \( -path /packages -o -path /proc -o -path /sys -o -path /tmp -o -path /home -o -path /var/cache/man \) -prune -o -name '*ferrocnc*' -print))
    [[ ${#left[@]} == 0 ]] || { echo "left: ${left[*]}"; return 1; }
    pass "purge leaves nothing"
}

case $1 in
    install) install ;;
    use) programs; hal; samples; without_a_card; example ;;
    purge) purge ;;
esac
