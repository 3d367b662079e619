//! Made-up computers, each with one thing wrong.

use super::{MODULE, Made, RTAPI_APP, elf};
use crate::finding::Verdict::{self, Bad, Good, Note, Skipped};

/// What is wrong, the check that tells of it, its verdict, and a word of the remedy.
pub(super) type Fault = (fn(&mut Made), &'static str, Verdict, &'static str);

/// One of each.
pub(super) const FAULTS: &[Fault] = &[
    (
        |m| m.file("proc/version", "Linux version 6.1.0 SMP PREEMPT_DYNAMIC"),
        "real-time kernel",
        Bad,
        "linux-image-rt",
    ),
    (
        |m| {
            m.file(
                "var/lib/dpkg/status",
                "Package: bash\nStatus: install ok installed\nVersion: 5\n",
            )
        },
        "LinuxCNC",
        Note,
        "apt install",
    ),
    (
        |m| {
            m.file(
                "var/lib/dpkg/status",
                "Package: linuxcnc-uspace\nStatus: install ok installed\nVersion: 1:2.8.4\n",
            )
        },
        "LinuxCNC",
        Bad,
        "Debian 12",
    ),
    (
        |m| m.mode(RTAPI_APP, 0o755),
        "rights of rtapi_app",
        Bad,
        "chmod u+s",
    ),
    (
        |m| m.remove(RTAPI_APP),
        "rights of rtapi_app",
        Skipped,
        "make setuid",
    ),
    (|m| m.forced = true, "forced real time", Note, "unset"),
    (|m| m.remove(MODULE), "module", Bad, "first-machine"),
    (
        |m| m.link(MODULE, "/nowhere/ferrocnc.so"),
        "module",
        Bad,
        "ls -l",
    ),
    (
        |m| {
            m.bytes(
                MODULE,
                &[
                    0x7f, b'E', b'L', b'F', 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 8, 0,
                ],
            )
        },
        "module",
        Bad,
        "build it",
    ),
    (
        |m| m.bytes(MODULE, b"no ELF file, but long enough"),
        "module",
        Bad,
        "build it",
    ),
    (
        |m| m.bytes(MODULE, &elf(1, env!("CARGO_PKG_VERSION"))),
        "module",
        Bad,
        "architecture",
    ),
    (|m| m.mode(MODULE, 0o600), "module", Bad, "chmod a+r"),
    (
        |m| m.bytes(MODULE, &elf(2, "0.0.1")),
        "release of the module",
        Note,
        "install-module",
    ),
    (
        |m| m.bytes(MODULE, &elf(2, "")[..64]),
        "release of the module",
        Note,
        "install-module",
    ),
    (
        |m| m.file("sys/devices/system/cpu/intel_pstate/no_turbo", "0"),
        "BIOS",
        Note,
        "hwlatdetect",
    ),
    (
        |m| m.file("sys/class/dmi/id/bios_version", "1.2"),
        "BIOS",
        Skipped,
        "hwlatdetect",
    ),
    (
        |m| {
            m.file(
                "proc/self/limits",
                "Max locked memory  8388608  8388608  bytes\n",
            )
        },
        "locked memory",
        Note,
        "ulimit",
    ),
    (
        |m| {
            m.file(
                "sys/devices/system/cpu/cpu3/cpufreq/scaling_governor",
                "powersave",
            )
        },
        "CPU frequency",
        Note,
        "scaling_governor",
    ),
    (
        |m| m.remove("sys/devices/system/cpu/isolated"),
        "isolated CPU",
        Note,
        "restart",
    ),
    (
        |m| {
            m.file("sys/devices/system/cpu/smt/active", "1");
            m.file(
                "sys/devices/system/cpu/cpu3/topology/thread_siblings_list",
                "1,3",
            );
        },
        "hyper-threads",
        Note,
        "smt/control",
    ),
    (
        |m| m.file("proc/irq/default_smp_affinity", "f"),
        "interrupts",
        Note,
        "restart",
    ),
    (
        |m| m.file("proc/sys/kernel/sched_rt_runtime_us", "950000"),
        "real-time throttling",
        Note,
        "sched_rt_runtime_us",
    ),
    (
        |m| {
            m.file(
                "sys/devices/system/clocksource/clocksource0/current_clocksource",
                "hpet",
            )
        },
        "clock",
        Bad,
        "dmesg",
    ),
    (
        |m| m.file("proc/812/comm", "irqbalance"),
        "irqbalance",
        Note,
        "systemctl",
    ),
    (
        |m| m.file("proc/cpuinfo", "flags\t\t: fpu tsc hypervisor msr\n"),
        "virtual machine",
        Bad,
        "computer of its own",
    ),
    (
        |m| m.file("sys/class/net/eth1/wireless/status", "0"),
        "port",
        Bad,
        "cable",
    ),
    (
        |m| m.link("sys/class/net/eth1/master", "../br0"),
        "port",
        Bad,
        "nomaster",
    ),
    (
        |m| {
            m.link(
                "sys/class/net/eth1/device",
                "../../../devices/pci0/usb1/1-1/1-1:1.0",
            )
        },
        "port",
        Bad,
        "slot",
    ),
    (
        |m| m.remove("sys/class/net/eth1/device"),
        "port",
        Note,
        "card",
    ),
    (|m| m.remove("sys/class/net/eth1"), "port", Bad, "ip link"),
    (
        |m| {
            m.link(
                "sys/devices/pci0/net/driver",
                "../../../bus/pci/drivers/r8169",
            )
        },
        "driver",
        Note,
        "r8168-dkms",
    ),
    (
        |m| {
            m.link(
                "sys/devices/pci0/net/driver",
                "../../../bus/pci/drivers/alx",
            )
        },
        "driver",
        Skipped,
        "selftest",
    ),
    (
        |m| m.file("sys/class/net/eth1/carrier", "0"),
        "link",
        Bad,
        "cable",
    ),
    (
        |m| m.file("sys/class/net/eth1/speed", "100"),
        "link",
        Note,
        "four pairs",
    ),
    (
        |m| m.file("sys/class/net/eth1/duplex", "half"),
        "link",
        Bad,
        "autoneg",
    ),
    (
        |m| m.coalescing = "Adaptive RX: off  TX: off\nrx-usecs: 3\n",
        "coalescing",
        Note,
        "rx-usecs 0",
    ),
    (
        |m| m.coalescing = "Adaptive RX: on  TX: off\nrx-usecs: 0\n",
        "coalescing",
        Note,
        "adaptive-rx off",
    ),
    (
        |m| m.ethtool = false,
        "coalescing",
        Skipped,
        "apt install ethtool",
    ),
    (
        |m| m.file("proc/irq/45/smp_affinity_list", "0-3"),
        "its interrupts",
        Note,
        "irq/45",
    ),
    (
        |m| m.file("sys/class/net/eth1/queues/rx-1/rps_cpus", "0"),
        "receive queues",
        Note,
        "combined 1",
    ),
    (
        |m| m.energy = "\tEEE status: enabled - active\n",
        "energy-efficient Ethernet",
        Note,
        "eee off",
    ),
    (
        |m| m.pause = "Autonegotiate:\ton\nRX:\t\ton\nTX:\t\toff\n",
        "pause frames",
        Note,
        "rx off",
    ),
    (
        |m| m.file("sys/devices/pci0/net/power/control", "auto"),
        "power of the card",
        Note,
        "power/control",
    ),
    (
        |m| m.file("sys/class/net/eth1/statistics/rx_crc_errors", "12"),
        "errors",
        Note,
        "another cable",
    ),
    (
        |m| m.file("sys/class/net/eth1/mtu", "9000"),
        "longest frame",
        Note,
        "mtu 1500",
    ),
    (
        |m| m.ip = "eth1 UP\n",
        "address",
        Bad,
        "ferrocnc net setup eth1 192.168.2.50",
    ),
    (
        |m| m.ip = "eth1 UP 192.168.2.50/24\n",
        "address",
        Bad,
        "ip addr del",
    ),
    (
        |m| m.ip = "eth1 UP 192.168.3.1/24\n",
        "address",
        Bad,
        "ferrocnc net setup eth1 192.168.2.50",
    ),
    (
        |m| m.ip = "eth1 UP 192.168.2.1/24 10.1.0.1/8\n",
        "address",
        Note,
        "ip addr del",
    ),
    (
        |m| {
            m.routes(&[
                ("eth1", "00000000", "00000000"),
                ("eth1", "0002A8C0", "00FFFFFF"),
            ])
        },
        "the port is the board's",
        Bad,
        "another port",
    ),
    (
        |m| {
            m.routes(&[
                ("eth1", "0002A8C0", "00FFFFFF"),
                ("eth0", "0000A8C0", "0000FFFF"),
            ])
        },
        "the board's net",
        Bad,
        "ferrocnc set",
    ),
    (
        |m| m.routes(&[("eth1", "0003A8C0", "00FFFFFF")]),
        "interface",
        Bad,
        "ferrocnc net setup IF 192.168.2.50",
    ),
    (
        |m| {
            m.file("proc/net/arp", "IP address HW type Flags HW address Mask Device\n192.168.2.50 0x1 0x2 02:00:00:00:00:01 * eth1\n")
        },
        "neighbour entry",
        Note,
        "lladdr 02:00:00:00:00:01 nud permanent",
    ),
    (
        |m| m.remove("proc/net/arp"),
        "neighbour entry",
        Skipped,
        "ferrocnc describe",
    ),
    (
        |m| m.file("proc/sys/net/ipv4/conf/all/rp_filter", "1"),
        "reverse-path filter",
        Good,
        "",
    ),
    (
        |m| {
            m.file("proc/sys/net/ipv4/conf/all/rp_filter", "1");
            m.file("proc/sys/net/ipv4/conf/eth1/rp_filter", "0");
        },
        "reverse-path filter",
        Note,
        "rp_filter=2",
    ),
    (
        |m| m.file("proc/sys/net/ipv6/conf/eth1/disable_ipv6", "0"),
        "IPv6 on the port",
        Note,
        "disable_ipv6=1",
    ),
    (
        |m| {
            m.file(
                "proc/sysvipc/shm",
                "key shmid perms\n1212238898 0 600\n7 1 600\n",
            )
        },
        "HAL of an earlier run",
        Note,
        "ipcrm -M 0x48414c32",
    ),
    (
        |m| {
            m.path = "/home/u/linuxcnc/bin:/usr/bin";
            m.file("home/u/linuxcnc/bin/rtapi_app", "");
        },
        "LinuxCNC's build",
        Bad,
        "install-module --rip /home/u/linuxcnc",
    ),
    (
        |m| {
            m.path = "/home/u/linuxcnc/bin:/usr/bin";
            m.file("home/u/linuxcnc/bin/rtapi_app", "");
            m.file("home/u/linuxcnc/rtlib/ferrocnc.so", "");
        },
        "LinuxCNC's build",
        Note,
        "install-module --rip /home/u/linuxcnc",
    ),
    (|m| m.cpu = Some("1"), "LinuxCNC's CPU", Note, "unset"),
    (|m| m.cpu = Some("3"), "LinuxCNC's CPU", Good, ""),
    (
        |m| {
            m.file(
                "sys/devices/system/cpu/cpuidle/current_driver",
                "intel_idle",
            )
        },
        "idle states",
        Note,
        "restart",
    ),
    (
        |m| {
            m.file(
                "sys/devices/system/cpu/cpuidle/current_driver",
                "intel_idle",
            );
            m.file("dev/cpu_dma_latency", "");
        },
        "idle states",
        Good,
        "",
    ),
    (
        |m| {
            m.file(
                "sys/module/pcie_aspm/parameters/policy",
                "default performance [powersave]",
            )
        },
        "power of PCIe",
        Note,
        "pcie_aspm/parameters/policy",
    ),
    (
        |m| m.file("proc/modules", "nvidia_drm 1 0 - Live\nnvidia 2 1 - Live\n"),
        "graphics driver",
        Note,
        "free driver",
    ),
    (
        |m| m.chip = "00:1f.6 Ethernet controller: Intel Corporation I219-LM\n",
        "chip",
        Note,
        "i210",
    ),
    (
        |m| m.chip = "03:00.0 Ethernet controller: Made Up 1\n",
        "chip",
        Skipped,
        "--soak",
    ),
    (
        |m| {
            m.file("proc/77/comm", "irq/45-eth1");
            let zeros = " 0".repeat(36);
            m.file("proc/77/stat", &format!("77 (irq/45-eth1) S{zeros} 10 1"));
        },
        "interrupt threads",
        Note,
        "chrt -f -p 80 77",
    ),
    (
        |m| m.offloads = "generic-receive-offload: on\nlarge-receive-offload: on [fixed]\n",
        "offloads",
        Note,
        "-K eth1 gro off",
    ),
    (
        |m| m.file("etc/network/interfaces", "iface eth1 inet static\n"),
        "manager of the port",
        Bad,
        "remove `iface eth1`",
    ),
    (
        |m| m.method = "auto\n",
        "where the address is from",
        Bad,
        "ferrocnc net setup eth1 192.168.2.50",
    ),
    (
        |m| {
            m.connection = "--\n";
            m.file("etc/network/interfaces", "iface eth1 inet dhcp\n");
        },
        "where the address is from",
        Bad,
        "ferrocnc net setup eth1 192.168.2.50",
    ),
    (
        |m| m.file("etc/ufw/ufw.conf", "# ufw\nENABLED=yes\n"),
        "firewall",
        Note,
        "ufw allow in on eth1 from 192.168.2.50",
    ),
    (
        |m| m.file("proc/812/comm", "firewalld"),
        "firewall",
        Note,
        "firewall-cmd",
    ),
    (
        |m| m.file("proc/812/comm", "avahi-daemon"),
        "programs that send there",
        Note,
        "ferrocnc net setup eth1 192.168.2.50",
    ),
    (
        |m| {
            m.file("proc/812/comm", "avahi-daemon");
            m.file(
                "etc/avahi/avahi-daemon.conf",
                "deny-interfaces = eth2, eth1\n",
            );
        },
        "programs that send there",
        Good,
        "",
    ),
    (
        |m| m.file("proc/812/comm", "nmap"),
        "pings and scans",
        Note,
        "while the machine runs",
    ),
    (
        |m| {
            m.file(
                "proc/net/arp",
                "IP address HW type Flags HW address Mask Device\n192.168.2.50 0x1 0x6 02:00:00:00:00:01 * eth1\n192.168.2.9 0x1 0x2 02:00:00:00:00:02 * eth1\n192.168.2.8 0x1 0x0 00:00:00:00:00:00 * eth1\n10.0.0.1 0x1 0x2 02:00:00:00:00:03 * eth0\n",
            )
        },
        "switch in between",
        Note,
        "nothing but boards",
    ),
    (
        |m| m.lldp = "lldp.eth1.via=LLDP\nlldp.eth1.chassis.name=switch\n",
        "switch in between",
        Note,
        "a cable",
    ),
    (
        |m| m.sends = true,
        "frames sent there",
        Note,
        "tcpdump -ni eth1",
    ),
    (
        |m| m.file("proc/812/comm", "rtapi_app"),
        "frames sent there",
        Skipped,
        "end LinuxCNC",
    ),
    (
        |m| m.ping = "60000 packets transmitted, 60000 received, 0% packet loss, time 59999ms\nrtt min/avg/max/mdev = 0.046/0.091/0.312/0.033 ms\n",
        "round trip of a ping",
        Note,
        "processor and port",
    ),
    (
        |m| m.ping = "60000 packets transmitted, 59998 received, 0.003% packet loss, time 59999ms\nrtt min/avg/max/mdev = 0.046/0.047/0.058/0.003 ms\n",
        "round trip of a ping",
        Bad,
        "another cable",
    ),
    (
        |m| m.ping = "chrt: failed to set pid 0's policy: Operation not permitted\n",
        "round trip of a ping",
        Skipped,
        "sudo ferrocnc doctor",
    ),
    (
        |m| m.ping_there = "60000 packets transmitted, 60000 received, 0% packet loss, time 59999ms\nrtt min/avg/max/mdev = 0.046/0.047/0.083/0.003 ms\n",
        "the same on CPU 3",
        Note,
        "processor and port",
    ),
    (
        |m| m.file("proc/812/comm", "rtapi_app"),
        "the same on CPU 3",
        Skipped,
        "end LinuxCNC",
    ),
    (
        |m| {
            m.file("sys/class/net/eth1/ifindex", "3");
            m.file("run/systemd/netif/links/3", "ADMIN_STATE=configured\n");
        },
        "manager of the port",
        Bad,
        "/etc/systemd/network",
    ),
    (
        |m| {
            m.connection = "--\n";
            m.file("sys/class/net/eth1/ifindex", "3");
            m.file("run/systemd/netif/leases/3", "ADDRESS=192.168.2.7\n");
        },
        "where the address is from",
        Bad,
        "ferrocnc net setup eth1 192.168.2.50",
    ),
    (
        |m| m.nft = "table inet filter {\n\tchain input {\n\t\ttype filter hook input priority filter; policy drop;\n\t}\n}\n",
        "firewall",
        Note,
        "nft list ruleset",
    ),
];
