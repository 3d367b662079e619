//! Every check against a made-up computer with one fault.

mod faults;

use super::*;
use crate::finding::Verdict::{Bad, Good, Note, Skipped};
use crate::finding::without_macs;
use faults::FAULTS;
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
    (
        "proc/net/dev",
        "Inter-| Receive | Transmit\n eth1: 9 8 0 0 0 0 0 0 7 1000 0 0 0 0 0 0",
    ),
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

/// What `ping` prints on it.
const PING: &str = "60000 packets transmitted, 60000 received, 0% packet loss, time 59999ms
rtt min/avg/max/mdev = 0.046/0.047/0.058/0.003 ms\n";

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
    lldp: &'static str,
    arping: &'static str,
    ping: &'static str,
    ping_there: &'static str,
    nft: &'static str,
    hal: String,
    sends: bool,
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
            lldp: "",
            arping: "",
            ping: PING,
            ping_there: PING,
            nft: "",
            hal: String::new(),
            sends: false,
            ethtool: true,
            forced: false,
            cpu: None,
            path: "/usr/local/bin:/usr/bin",
        };
        made.bytes(MODULE, &elf(2, env!("CARGO_PKG_VERSION")));
        made.mode(MODULE, 0o644);
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
        self.asked(|system| examine(system, subject))
    }

    /// What comes of a question to this computer.
    fn asked<T>(&self, ask: impl FnOnce(&System<'_>) -> T) -> T {
        let run = |program: &str, arguments: &[&str]| {
            let text = match (program, arguments.first()) {
                ("ip", _) => self.ip,
                ("getcap", _) => self.getcap,
                ("ethtool", Some(&"-c")) if self.ethtool => self.coalescing,
                ("ethtool", Some(&"--show-eee")) if self.ethtool => self.energy,
                ("ethtool", Some(&"-a")) if self.ethtool => self.pause,
                ("ethtool", Some(&"-k")) if self.ethtool => self.offloads,
                ("lspci", _) => self.chip,
                ("lldpcli", _) => self.lldp,
                ("arping", _) => self.arping,
                ("chrt", _) => self.ping,
                ("taskset", Some(&"-c")) if arguments.contains(&"3") => self.ping_there,
                ("nft", _) => self.nft,
                ("halcmd", _) => self.hal.as_str(),
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
            wait: &|_| {
                if self.sends {
                    self.file("proc/net/dev", " eth1: 9 8 0 0 0 0 0 0 7 1003 0 0 0 0 0 0");
                }
            },
        };
        ask(&system)
    }
}

impl Drop for Made {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.root);
    }
}

/// A module for this processor, of this class of ELF and this release.
fn elf(class: u8, release: &str) -> Vec<u8> {
    let machine: u16 = match std::env::consts::ARCH {
        "x86_64" => 62,
        "aarch64" => 183,
        "arm" => 40,
        _ => 243,
    };
    let mut bytes = vec![0u8; 64];
    bytes[..4].copy_from_slice(b"\x7fELF");
    bytes[4] = class;
    bytes[18..20].copy_from_slice(&machine.to_le_bytes());
    bytes.extend(format!("{}{release}\0", crate::module::VERSION_MARK).bytes());
    bytes
}

/// Checks of what is not to be read from here: always advice.
const ADVICE: [&str; 2] = ["BIOS", "LinuxCNC's latency"];

fn board() -> Subject {
    Subject {
        board: Some(BOARD),
        interface: None,
        listen: Some(Duration::from_secs(10)),
        ping: Some(Duration::from_secs(60)),
    }
}

#[test]
fn a_healthy_computer_has_nothing_to_be_told_of() {
    let report = Made::healthy().examine(&board());
    for finding in &report.findings {
        match ADVICE.contains(&finding.check.as_str()) {
            true => assert!(!finding.remedy.is_empty(), "{finding:?}"),
            false => assert_eq!(finding.verdict, Good, "{finding:?}"),
        }
    }
    assert!(report.findings.len() > 44, "{}", report.findings.len());
    assert_eq!(report.to_json()["computer"]["processor"], "Made Up 3000");
}

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
    assert!(FAULTS.len() >= 72, "{}", FAULTS.len());
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
        ..Subject::default()
    };
    assert_eq!(port(&named).as_deref(), Some("eth1, wired"));
    assert_eq!(port(&Subject::default()), None);
    let twin = Subject {
        board: Some(Ipv4Addr::LOCALHOST),
        ..Subject::default()
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
        ..Subject::default()
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
fn two_that_answer_for_one_address_are_told_and_no_hardware_address_is() {
    let one = "Unicast reply from 192.168.2.50 [02:00:00:00:00:01]  0.7ms\n";
    let two = "Unicast reply from 192.168.2.50 [02:00:00:00:00:01]  0.7ms\nUnicast reply from 192.168.2.50 [02:00:00:00:00:02]  0.9ms\n";
    for (said, verdict) in [("", Skipped), (one, Good), (two, Bad)] {
        let mut made = Made::healthy();
        made.arping = said;
        let finding = made.asked(|system| line::owners(system, "eth1", BOARD));
        assert_eq!(finding.verdict, verdict, "{finding:?}");
        assert!(!format!("{finding:?}").contains("02:00"), "{finding:?}");
    }
    let made = Made::healthy();
    made.file("proc/812/comm", "rtapi_app");
    let asked = made.asked(|system| line::boards(system, "eth1"));
    assert_eq!(asked[0].verdict, Skipped, "nothing is asked: {asked:?}");
}

/// What `halcmd -s show` prints of a machine that is in order.
const HAL: &str = "motmod u32 OUT 2000000 motion.servo.last-period
ferrocnc s32 OUT 0 ferrocnc.0.packet-error-level
ferrocnc u32 OUT 0 ferrocnc.0.packet-error-total ==> lost
ferrocnc u32 OUT 0 ferrocnc.0.link.errors
ferrocnc u32 OUT 3500000 ferrocnc.0.watchdog.margin-ns-min
ferrocnc u32 RW 5000000 ferrocnc.0.watchdog.timeout-ns
ferrocnc s32 RW 80000 ferrocnc.0.read.tmax
ferrocnc s32 RW 120000 ferrocnc.0.write.tmax
";

#[test]
fn a_running_machine_is_judged_by_its_own_pins() {
    let judged = |hal: &str, check: &str| {
        let mut made = Made::healthy();
        made.file("proc/812/comm", "rtapi_app");
        made.hal = hal.to_owned();
        let all = made.asked(running::examine);
        all.into_iter()
            .find(|it| it.check == check)
            .map(|it| (it.verdict, it.fact))
            .unwrap_or_else(|| panic!("{check} was not looked at"))
    };
    let with = |from: &str, to: &str, check: &str| {
        assert!(HAL.contains(from), "{from}");
        judged(&HAL.replace(from, to), check)
    };
    let (time, answers, watchdog) = (
        "ferrocnc.0's time",
        "ferrocnc.0's answers",
        "ferrocnc.0's watchdog",
    );
    for check in [time, answers, watchdog] {
        assert_eq!(judged(HAL, check).0, Good, "{check}");
    }
    assert!(judged(HAL, time).1.contains("10 %"));
    assert!(judged(HAL, watchdog).1.contains("70 %"));
    assert_eq!(with("80000 ", "980000 ", time).0, Note);
    assert_eq!(with("2000000 ", "0 ", time).0, Skipped);
    assert_eq!(
        with(
            "0 ferrocnc.0.packet-error-total",
            "7 ferrocnc.0.packet-error-total",
            answers
        ),
        (Note, "missing 7".into())
    );
    assert_eq!(
        with(
            "0 ferrocnc.0.packet-error-level",
            "4 ferrocnc.0.packet-error-level",
            answers
        )
        .0,
        Bad
    );
    assert_eq!(
        with(
            "0 ferrocnc.0.link.errors",
            "2 ferrocnc.0.link.errors",
            answers
        ),
        (Note, "frames damaged 2".into())
    );
    assert_eq!(with("3500000 ", "900000 ", watchdog).0, Note);
    assert_eq!(with("3500000 ", "4294967295 ", watchdog).0, Skipped);
    assert_eq!(judged("", "the running machine").0, Skipped);
}

#[test]
fn errors_of_the_port_are_told_if_they_grow_while_the_line_is_measured() {
    let made = Made::healthy();
    let path = "sys/class/net/eth1/statistics/rx_crc_errors";
    made.file(path, "7");
    let count = || made.asked(|system| port::Errors::read(system, "eth1"));
    let before = count();
    assert_eq!(count().since(before).verdict, Good);
    made.file(path, "9");
    let finding = count().since(before);
    assert_eq!(finding.verdict, Bad, "{finding:?}");
    assert_eq!(finding.fact, "rx_crc_errors 2 in that time");
    assert!(finding.remedy.contains("cable"), "{finding:?}");
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
