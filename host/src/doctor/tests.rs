//! Every check against a made-up computer with one fault.

use super::*;
use crate::finding::Verdict::{self, Bad, Good, Note, Skipped};
use crate::finding::without_macs;
use std::fs;
use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};

const BOARD: Ipv4Addr = Ipv4Addr::new(192, 168, 2, 50);
const MODULE: &str = "usr/lib/linuxcnc/modules/ferrocnc.so";
const RTAPI_APP: &str = "usr/bin/rtapi_app";
const PORT: &str = "sys/class/net/eth1";
const ROUTES: &str = "Iface Destination Gateway Flags RefCnt Use Metric Mask MTU Window IRTT\n";

/// The files of a healthy computer.
const FILES: &[(&str, &str)] = &[
    (
        "proc/version",
        "Linux version 6.1.0-rt #1 SMP PREEMPT_RT Debian",
    ),
    ("proc/sys/kernel/osrelease", "6.1.0-rt"),
    ("proc/cmdline", "isolcpus=3 irqaffinity=0-2"),
    (
        "proc/cpuinfo",
        "model name\t: Made Up 3000\nflags\t\t: fpu tsc msr\n",
    ),
    (
        "proc/self/limits",
        "Max locked memory         unlimited  unlimited  bytes\n",
    ),
    (
        "var/lib/dpkg/status",
        "Package: bash\nStatus: install ok installed\nVersion: 5\n\nPackage: linuxcnc-uspace\nStatus: install ok installed\nVersion: 1:2.9.0~pre1+git20230208-1\n",
    ),
    ("sys/devices/system/cpu/online", "0-3"),
    ("sys/devices/system/cpu/isolated", "3"),
    ("sys/devices/system/cpu/smt/active", "0"),
    (
        "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor",
        "performance",
    ),
    (
        "sys/devices/system/cpu/cpu3/cpufreq/scaling_governor",
        "performance",
    ),
    ("proc/sys/kernel/sched_rt_runtime_us", "-1"),
    (
        "sys/devices/system/clocksource/clocksource0/current_clocksource",
        "tsc",
    ),
    ("proc/irq/default_smp_affinity", "7"),
    ("proc/1/comm", "systemd"),
    ("sys/class/net/eth1/carrier", "1"),
    ("sys/class/net/eth1/speed", "1000"),
    ("sys/class/net/eth1/duplex", "full"),
    ("sys/class/net/eth1/mtu", "1500"),
    ("sys/class/net/eth1/statistics/rx_errors", "0"),
    ("sys/class/net/eth1/statistics/rx_crc_errors", "0"),
    ("sys/class/net/eth1/queues/rx-0/rps_cpus", "0"),
    ("sys/devices/pci0/net/power/control", "on"),
    (
        "proc/interrupts",
        "      CPU0 CPU1\n 45:   10   0  PCI-MSI 1 eth1\n 46:   1   1  PCI-MSI 2 eth0\n",
    ),
    ("proc/irq/45/smp_affinity_list", "3"),
    (
        "proc/net/arp",
        "IP address HW type Flags HW address Mask Device\n192.168.2.50 0x1 0x6 02:00:00:00:00:01 * eth1\n",
    ),
    ("proc/sys/net/ipv4/conf/all/rp_filter", "0"),
    ("proc/sys/net/ipv4/conf/eth1/rp_filter", "2"),
    ("proc/sys/net/ipv6/conf/eth1/disable_ipv6", "1"),
];

/// A computer made of files, with what its programs print.
struct Made {
    root: PathBuf,
    ip: &'static str,
    coalescing: &'static str,
    energy: &'static str,
    pause: &'static str,
    getcap: &'static str,
    offloads: &'static str,
    chip: &'static str,
    connection: &'static str,
    method: &'static str,
    ethtool: bool,
    forced: bool,
    cpu: Option<&'static str>,
    path: &'static str,
}

impl Made {
    /// One on which nothing is wrong.
    fn healthy() -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let name = format!(
            "ferrocnc-doctor-{}-{}",
            std::process::id(),
            NEXT.fetch_add(1, Ordering::Relaxed)
        );
        let made = Made {
            root: std::env::temp_dir().join(name),
            ip: "eth1 UP 192.168.2.1/24\n",
            coalescing: "Coalesce parameters for eth1:\nAdaptive RX: off  TX: off\nrx-usecs: 0\n",
            energy: "EEE settings for eth1:\n\tEEE status: disabled\n",
            pause: "Pause parameters for eth1:\nAutonegotiate:\ton\nRX:\t\toff\nTX:\t\toff\n",
            getcap: "",
            offloads: "generic-receive-offload: off\nlarge-receive-offload: off [fixed]\n",
            chip: "02:00.0 Ethernet controller: Intel Corporation I210 Gigabit (rev 03)\n",
            connection: "ferrocnc-eth1\n",
            method: "manual\n",
            ethtool: true,
            forced: false,
            cpu: None,
            path: "/usr/local/bin:/usr/bin",
        };
        let elf = |machine: u16| {
            let mut head = vec![0u8; 64];
            head[..4].copy_from_slice(b"\x7fELF");
            head[18..20].copy_from_slice(&machine.to_le_bytes());
            head
        };
        let machine = match std::env::consts::ARCH {
            "x86_64" => 62,
            "aarch64" => 183,
            "arm" => 40,
            _ => 243,
        };
        made.bytes(MODULE, &elf(machine));
        made.file(RTAPI_APP, "");
        made.mode(RTAPI_APP, 0o4755);
        for (path, text) in FILES {
            made.file(path, text);
        }
        made.routes(&[
            ("eth0", "00000000", "00000000"),
            ("eth1", "0002A8C0", "00FFFFFF"),
            ("eth0", "0000000A", "000000FF"),
        ]);
        made.link(&format!("{PORT}/device"), "../../../devices/pci0/net");
        made.link(
            "sys/devices/pci0/net/driver",
            "../../../bus/pci/drivers/igb",
        );
        made
    }

    fn bytes(&self, path: &str, bytes: &[u8]) {
        let path = self.root.join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }

    fn file(&self, path: &str, text: &str) {
        self.bytes(path, text.as_bytes());
    }

    fn mode(&self, path: &str, mode: u32) {
        fs::set_permissions(self.root.join(path), fs::Permissions::from_mode(mode)).unwrap();
    }

    fn link(&self, path: &str, to: &str) {
        let path = self.root.join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        let _ = fs::remove_file(&path);
        symlink(to, path).unwrap();
    }

    fn remove(&self, path: &str) {
        let path = self.root.join(path);
        let _ = fs::remove_file(&path).or_else(|_| fs::remove_dir_all(&path));
    }

    fn routes(&self, all: &[(&str, &str, &str)]) {
        let lines = all.iter().map(|(interface, net, mask)| {
            format!("{interface}\t{net}\t00000000\t0001\t0\t0\t0\t{mask}\t0\t0\t0\n")
        });
        self.file(
            "proc/net/route",
            &(ROUTES.to_owned() + &lines.collect::<String>()),
        );
    }

    fn examine(&self, subject: &Subject) -> Report {
        let run = |program: &str, arguments: &[&str]| {
            let text = match (program, arguments.first()) {
                ("ip", _) => self.ip,
                ("getcap", _) => self.getcap,
                ("ethtool", Some(&"-c")) if self.ethtool => self.coalescing,
                ("ethtool", Some(&"--show-eee")) if self.ethtool => self.energy,
                ("ethtool", Some(&"-a")) if self.ethtool => self.pause,
                ("ethtool", Some(&"-k")) if self.ethtool => self.offloads,
                ("lspci", _) => self.chip,
                ("nmcli", _) if arguments.contains(&"GENERAL.CONNECTION") => self.connection,
                ("nmcli", _) if arguments.contains(&"ipv4.method") => self.method,
                _ => return None,
            };
            Some(text.to_owned())
        };
        let system = System {
            root: self.root.clone(),
            root_uid: fs::metadata(self.root.join(RTAPI_APP)).map_or(0, |it| it.uid()),
            run: &run,
            variable: &|name| match name {
                "LINUXCNC_FORCE_REALTIME" => self.forced.then(|| "1".to_owned()),
                "RTAPI_CPU_NUMBER" => self.cpu.map(str::to_owned),
                "PATH" => Some(self.path.to_owned()),
                _ => None,
            },
        };
        examine(&system, subject)
    }
}

impl Drop for Made {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.root);
    }
}

fn board() -> Subject {
    Subject {
        board: Some(BOARD),
        interface: None,
    }
}

#[test]
fn a_healthy_computer_has_nothing_to_be_told_of() {
    let report = Made::healthy().examine(&board());
    for finding in &report.findings {
        assert_eq!(finding.verdict, Good, "{finding:?}");
    }
    assert!(report.findings.len() > 42, "{}", report.findings.len());
    assert_eq!(report.to_json()["computer"]["processor"], "Made Up 3000");
}

/// What is wrong, the check that tells of it, its verdict, and a word of the remedy.
type Fault = (fn(&mut Made), &'static str, Verdict, &'static str);

const FAULTS: &[Fault] = &[
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
];

#[test]
fn every_fault_is_named_by_its_check_with_a_remedy() {
    for (break_it, check, verdict, remedy) in FAULTS {
        let mut made = Made::healthy();
        break_it(&mut made);
        let report = made.examine(&board());
        let finding = report
            .findings
            .iter()
            .find(|finding| finding.check == *check);
        let finding = finding.unwrap_or_else(|| panic!("{check} was not looked at: {report:?}"));
        assert_eq!(finding.verdict, *verdict, "{finding:?}");
        assert!(
            finding.remedy.contains(remedy),
            "{finding:?} does not say {remedy}"
        );
        if *verdict != Good {
            assert!(!finding.reason.is_empty(), "{finding:?}");
        }
    }
    assert!(FAULTS.len() >= 65, "{}", FAULTS.len());
}

#[test]
fn rights_as_capabilities_are_as_good_as_roots_if_they_are_all_there() {
    let all = "/usr/bin/rtapi_app cap_ipc_lock,cap_net_admin,cap_sys_rawio,cap_sys_nice=ep\n";
    let no_memory = "/usr/bin/rtapi_app cap_net_admin,cap_sys_nice=ep\n";
    for (getcap, verdict) in [(all, Good), (no_memory, Bad)] {
        let mut made = Made::healthy();
        made.mode(RTAPI_APP, 0o755);
        made.getcap = getcap;
        let report = made.examine(&board());
        let mut findings = report.findings.iter();
        let finding = findings.find(|it| it.check == "rights of rtapi_app");
        assert_eq!(finding.map(|it| it.verdict), Some(verdict), "{getcap}");
    }
}

#[test]
fn the_interface_is_the_one_whose_net_is_the_narrowest_or_the_one_that_was_named() {
    let made = Made::healthy();
    made.routes(&[
        ("eth0", "00000000", "00000000"),
        ("eth2", "0000A8C0", "0000FFFF"),
        ("eth1", "0002A8C0", "00FFFFFF"),
    ]);
    let port = |subject: &Subject| {
        let report = made.examine(subject);
        report
            .findings
            .iter()
            .find(|it| it.check == "port")
            .map(|it| it.fact.clone())
    };
    assert_eq!(port(&board()).as_deref(), Some("eth1, wired"));
    let named = Subject {
        board: None,
        interface: Some("eth1".into()),
    };
    assert_eq!(port(&named).as_deref(), Some("eth1, wired"));
    assert_eq!(port(&Subject::default()), None);
    let twin = Subject {
        board: Some(Ipv4Addr::LOCALHOST),
        interface: None,
    };
    made.file("sys/class/net/lo/mtu", "65536");
    assert_eq!(port(&twin).as_deref(), Some("lo, this computer itself"));
}

#[test]
fn an_empty_computer_is_no_reason_to_panic() {
    let made = Made::healthy();
    fs::remove_dir_all(&made.root).unwrap();
    let named = Subject {
        board: Some(BOARD),
        interface: Some("eth1".into()),
    };
    for subject in [board(), named, Subject::default()] {
        let report = made.examine(&subject);
        assert!(report.findings.iter().any(|it| it.verdict == Bad));
    }
}

#[test]
fn lists_and_masks_are_read_as_the_kernel_writes_them() {
    use super::system::{mask, numbers};
    let all = |set: std::collections::BTreeSet<u32>| set.into_iter().collect::<Vec<_>>();
    assert_eq!(all(numbers("0-2,5")), [0, 1, 2, 5]);
    assert!(all(numbers("")).is_empty());
    assert_eq!(all(mask("00000001,00000005")), [0, 2, 32]);
    assert_eq!(all(mask("f")), [0, 1, 2, 3]);
}

#[test]
fn nothing_is_measured_while_linuxcnc_runs() {
    let made = Made::healthy();
    let system = System {
        root: made.root.clone(),
        ..System::real()
    };
    assert_eq!(soak::refusal(&system), None);
    made.file("proc/812/comm", "rtapi_app\n");
    let why = soak::refusal(&system).expect("a reason");
    assert!(
        why.contains("rtapi_app") && why.contains("end LinuxCNC"),
        "{why}"
    );
}

#[test]
fn a_report_for_others_has_no_hardware_address() {
    let made = Made::healthy();
    made.file("proc/net/arp", "IP address HW type Flags HW address Mask Device\n192.168.2.50 0x1 0x2 02:00:00:00:00:01 * eth1\n");
    let text = made.examine(&board()).to_text();
    assert!(text.contains("lladdr 02:00:00:00:00:01 nud"), "{text}");
    let text = without_macs(&text);
    assert!(
        text.contains("lladdr MAC nud") && !text.contains("02:00"),
        "{text}"
    );
}

#[test]
fn a_card_is_told_only_of_the_coalescing_that_it_has() {
    for (has, off) in [
        (
            "Adaptive RX: n/a  TX: n/a\nrx-usecs:\t3\n",
            "-C eth1 rx-usecs 0",
        ),
        (
            "Adaptive RX: on  TX: off\nrx-usecs: n/a\n",
            "-C eth1 adaptive-rx off",
        ),
        (
            "Adaptive RX: on  TX: off\nrx-usecs: 3\n",
            "-C eth1 adaptive-rx off rx-usecs 0",
        ),
    ] {
        let mut made = Made::healthy();
        made.coalescing = has;
        let report = made.examine(&board());
        let finding = report.findings.iter().find(|it| it.check == "coalescing");
        let finding = finding.expect("a finding");
        assert!(finding.remedy.ends_with(off), "{has}: {finding:?}");
    }
}
