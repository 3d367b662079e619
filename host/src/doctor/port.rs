//! The Ethernet port: driver, link, interrupts, power.

use super::system::{System, numbers};
use crate::finding::Finding;

/// Drivers that LinuxCNC's users report good times with.
const GOOD_DRIVERS: [&str; 3] = ["igb", "e1000e", "igc"];

/// All checks of this module.
pub fn examine(system: &System<'_>, interface: &str) -> Vec<Finding> {
    let port = Port { system, interface };
    let mut findings = vec![port.kind()];
    if port.has("device") {
        findings.extend([
            port.driver(),
            port.link(),
            port.coalescing(),
            port.interrupts(),
            port.queues(),
            port.energy(),
            port.pause(),
            port.power(),
        ]);
    }
    findings.extend([port.errors(), port.mtu()]);
    findings
}

/// Whether a card holds received frames back to save interrupts; `None` if it has no such setting.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Coalescing {
    /// For as long as it finds best.
    pub adaptive: Option<bool>,
    /// For this long, in microseconds.
    pub usecs: Option<u32>,
}

impl Coalescing {
    /// From what `ethtool -c` prints, if there is an ethtool.
    pub fn of(text: Option<&str>) -> Self {
        let text = text.unwrap_or_default();
        let value = |name: &str| {
            let line = text.lines().find_map(|line| line.trim().strip_prefix(name));
            line.and_then(|line| line.split_whitespace().next())
        };
        Coalescing {
            adaptive: match value("Adaptive RX:") {
                Some("on") => Some(true),
                Some("off") => Some(false),
                Some(_) | None => None,
            },
            usecs: value("rx-usecs:").and_then(|usecs| usecs.parse().ok()),
        }
    }

    /// What `ethtool -C IF` is told to switch it off; only what the card has, because it refuses
    /// the whole command for one setting that it has not.
    pub fn off(self) -> Option<String> {
        Coalescing {
            adaptive: self.adaptive.map(|_| false),
            usecs: self.usecs.map(|_| 0),
        }
        .now()
    }

    /// What makes it as it is.
    pub fn now(self) -> Option<String> {
        let adaptive = self.adaptive.map(|on| match on {
            true => "adaptive-rx on".to_owned(),
            false => "adaptive-rx off".to_owned(),
        });
        let usecs = self.usecs.map(|usecs| format!("rx-usecs {usecs}"));
        let words: Vec<_> = adaptive.into_iter().chain(usecs).collect();
        (!words.is_empty()).then(|| words.join(" "))
    }
}

/// The kernel's counters of what may be an error of the line.
const ERRORS: [&str; 5] = [
    "rx_errors",
    "rx_crc_errors",
    "rx_missed_errors",
    "rx_dropped",
    "tx_errors",
];

/// What a port has counted of each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Errors([u64; ERRORS.len()]);

impl Errors {
    /// Since the port started.
    pub fn read(system: &System<'_>, interface: &str) -> Self {
        Errors(ERRORS.map(|name| {
            let count = system.read(&format!("sys/class/net/{interface}/statistics/{name}"));
            count.and_then(|it| it.parse().ok()).unwrap_or_default()
        }))
    }

    /// What has come since an earlier look: nothing is to, while the line is in use.
    pub fn since(self, earlier: Self) -> Finding {
        let check = "errors of the port";
        let mut news = self;
        for (count, before) in news.0.iter_mut().zip(earlier.0) {
            *count = count.saturating_sub(before);
        }
        let news = news.told();
        match news.is_empty() {
            true => Finding::good(check, "none in that time"),
            false => Finding::bad(
                check,
                format!("{} in that time", news.join(", ")),
                "frames are damaged or dropped on the way",
                "another cable, away from motor leads; dropped ones: ethtool -g says how many the card can keep",
            ),
        }
    }

    /// Those that are not 0.
    fn told(self) -> Vec<String> {
        let all = ERRORS.iter().zip(self.0);
        let counted = all.filter(|(_, count)| *count != 0);
        counted
            .map(|(name, count)| format!("{name} {count}"))
            .collect()
    }
}

struct Port<'p> {
    system: &'p System<'p>,
    interface: &'p str,
}

impl Port<'_> {
    fn path(&self, name: &str) -> String {
        format!("sys/class/net/{}/{name}", self.interface)
    }

    fn has(&self, name: &str) -> bool {
        self.system.exists(&self.path(name))
    }

    fn read(&self, name: &str) -> Option<String> {
        self.system.read(&self.path(name))
    }

    fn ethtool(&self, option: &str) -> Option<String> {
        self.system.print("ethtool", &[option, self.interface])
    }

    /// What `ethtool OPTION IF TO` repairs, now and at every start of the port.
    fn by_ethtool(
        &self,
        check: &str,
        fact: String,
        reason: &str,
        option: &str,
        to: &str,
    ) -> Finding {
        let command = format!("ethtool {option} {} {to}", self.interface);
        Finding::note(check, fact, reason, &format!("sudo {command}")).lasting(format!(
            "`up {command}` below `iface {}` in /etc/network/interfaces, or a dispatcher script of NetworkManager",
            self.interface
        ))
    }

    fn without_ethtool(check: &str) -> Finding {
        Finding::skipped(
            check,
            "not known",
            "there is no ethtool",
            "sudo apt install ethtool",
        )
    }

    fn kind(&self) -> Finding {
        let (check, name) = ("port", self.interface);
        if !self.has("mtu") {
            return Finding::bad(
                check,
                format!("{name} is not there"),
                "this computer has no such interface",
                "see `ip link`",
            );
        }
        if self.has("wireless") || self.has("phy80211") {
            return Finding::bad(
                check,
                format!("{name} is wireless"),
                "radio loses frames and repeats them late",
                "a cable from an Ethernet port to the board",
            );
        }
        if self.has("master") {
            return Finding::bad(
                check,
                format!("{name} is part of a bridge or bond"),
                "frames of others wait in front of the board's",
                &format!("sudo ip link set {name} nomaster"),
            )
            .lasting("remove the bridge or bond from the network's configuration");
        }
        match self.system.link(&self.path("device")) {
            None if name == "lo" => Finding::note(
                check,
                "lo, this computer itself",
                "a simulated board",
                "name the interface of the real one",
            ),
            None => Finding::note(
                check,
                format!("{name} is no card"),
                "a virtual interface; what is below it is not looked at",
                "connect the board to a card of its own",
            ),
            Some(device) if device.contains("/usb") => Finding::bad(
                check,
                format!("{name} is a USB adapter"),
                "USB moves frames once in 125 us or later, and shares its wire",
                "a card in a slot, or the port on the main board",
            ),
            Some(_) => Finding::good(check, format!("{name}, wired")),
        }
    }

    fn driver(&self) -> Finding {
        let check = "driver";
        let link = self
            .system
            .link(&self.path("device/driver"))
            .unwrap_or_default();
        match link.rsplit('/').next().unwrap_or_default() {
            "" => Finding::skipped(check, "not known", "the kernel does not say", ""),
            good if GOOD_DRIVERS.contains(&good) => Finding::good(check, good),
            "r8169" => Finding::note(
                check,
                "r8169",
                "users report late frames with it; Realtek's own driver is better",
                "sudo apt install r8168-dkms (r8125-dkms for 2.5 Gbit/s), from non-free",
            ),
            other => Finding::skipped(
                check,
                other,
                "nothing is known of its times",
                "`ferrocnc selftest BOARD` measures the link",
            ),
        }
    }

    fn link(&self) -> Finding {
        let check = "link";
        if self.read("carrier").is_none_or(|carrier| carrier != "1") {
            return Finding::bad(
                check,
                "down",
                "no cable, no power on the board, or the port is switched off",
                &format!(
                    "plug the cable in, power the board, sudo ip link set {} up",
                    self.interface
                ),
            );
        }
        let (speed, duplex) = (
            self.read("speed").unwrap_or_default(),
            self.read("duplex").unwrap_or_default(),
        );
        let fact = format!("{speed} Mbit/s, {duplex} duplex");
        if duplex == "unknown" {
            return Finding::skipped(check, "up", "its driver knows no speed", "");
        }
        match (speed.parse::<u32>(), duplex.as_str()) {
            (Ok(1000..), "full") => Finding::good(check, fact),
            (Ok(_), "full") => Finding::note(
                check,
                fact,
                "an exchange takes ten times as long on the wire, or more",
                "a cable with four pairs; let both ends negotiate",
            ),
            _ => Finding::bad(
                check,
                fact,
                "half duplex loses frames when both ends send",
                &format!("sudo ethtool -s {} autoneg on", self.interface),
            ),
        }
    }

    fn coalescing(&self) -> Finding {
        let check = "coalescing";
        let Some(text) = self.ethtool("-c") else {
            return Self::without_ethtool(check);
        };
        let coalescing = Coalescing::of(Some(&text));
        let fact = match (coalescing.adaptive, coalescing.usecs) {
            (Some(true), _) => "adaptive".to_owned(),
            (_, None) => return Finding::good(check, "none"),
            (_, Some(0 | 1)) => return Finding::good(check, "off"),
            (_, Some(usecs)) => format!("{usecs} us"),
        };
        let reason = "the card keeps a frame back to save interrupts";
        let off = coalescing.off().unwrap_or_default();
        self.by_ethtool(check, fact, reason, "-C", &off)
            .lasting(super::network::setup(self.interface, None))
    }

    fn interrupts(&self) -> Finding {
        let check = "its interrupts";
        let table = self.system.read("proc/interrupts").unwrap_or_default();
        let lines = table.lines().filter(|line| {
            let name = line.split_whitespace().last().unwrap_or_default();
            name == self.interface || name.starts_with(&format!("{}-", self.interface))
        });
        let numbered: Vec<&str> = lines
            .filter_map(|line| line.trim().split_once(':'))
            .map(|(number, _)| number)
            .collect();
        if numbered.is_empty() {
            return Finding::skipped(
                check,
                "not found",
                "none in /proc/interrupts has the port's name",
                "",
            );
        }
        let wandering: Vec<&str> = numbered
            .iter()
            .copied()
            .filter(|number| {
                let path = format!("proc/irq/{number}/smp_affinity_list");
                numbers(&self.system.read(&path).unwrap_or_default()).len() != 1
            })
            .collect();
        match wandering.first() {
            None => Finding::good(check, format!("{}, each on one CPU", numbered.join(", "))),
            Some(first) => Finding::note(
                check,
                format!("{} may move", wandering.join(", ")),
                "a frame waits for a processor that does something else",
                &format!("echo C | sudo tee /proc/irq/{first}/smp_affinity_list, with C the servo thread's CPU or the one beside it; measure both"),
            )
            .lasting("the same line in a unit of systemd of type oneshot"),
        }
    }

    fn queues(&self) -> Finding {
        let check = "receive queues";
        let names = self.system.list(&self.path("queues"));
        let count = names.iter().filter(|name| name.starts_with("rx-")).count();
        match count {
            0 | 1 => Finding::good(check, count.to_string()),
            _ => {
                let reason = "each has its own interrupt; one is simpler to keep on one CPU";
                self.by_ethtool(check, count.to_string(), reason, "-L", "combined 1")
            }
        }
    }

    fn energy(&self) -> Finding {
        let check = "energy-efficient Ethernet";
        let Some(text) = self.ethtool("--show-eee") else {
            return Self::without_ethtool(check);
        };
        if !text.contains("EEE status: enabled") {
            return Finding::good(check, "off");
        }
        let reason = "the link sleeps between frames and wakes up late";
        self.by_ethtool(check, "on".to_owned(), reason, "--set-eee", "eee off")
    }

    fn pause(&self) -> Finding {
        let check = "pause frames";
        let Some(text) = self.ethtool("-a") else {
            return Self::without_ethtool(check);
        };
        let on = text.lines().any(|line| {
            let mut words = line.split_whitespace();
            words.next() == Some("RX:") && words.next() == Some("on")
        });
        if !on {
            return Finding::good(check, "off");
        }
        let reason = "a switch can keep this port from sending";
        self.by_ethtool(check, "on".to_owned(), reason, "-A", "rx off tx off")
    }

    fn power(&self) -> Finding {
        let check = "power of the card";
        match self.read("device/power/control").as_deref() {
            Some("auto") => Finding::note(
                check,
                "auto",
                "the card may sleep, and wakes up late",
                &format!(
                    "echo on | sudo tee /sys/class/net/{}/device/power/control",
                    self.interface
                ),
            )
            .lasting("pcie_aspm=off in the kernel's command line"),
            Some(other) => Finding::good(check, other),
            None => Finding::skipped(check, "not known", "the kernel does not say", ""),
        }
    }

    fn errors(&self) -> Finding {
        let check = "errors";
        let counted = Errors::read(self.system, self.interface).told();
        match counted.is_empty() {
            true => Finding::good(check, "none since the port started"),
            false => Finding::note(
                check,
                counted.join(", "),
                "a lost frame is a period without a command",
                "another cable, away from motor leads; look again later whether they grow",
            ),
        }
    }

    fn mtu(&self) -> Finding {
        let check = "longest frame";
        match self.read("mtu").as_deref() {
            Some("1500") => Finding::good(check, "1500 bytes"),
            _ if self.interface == "lo" => Finding::good(check, "does not matter here"),
            None => Finding::skipped(check, "not known", "the interface is not there", ""),
            Some(mtu) => Finding::note(
                check,
                format!("{mtu} bytes"),
                "the board takes frames of 1500 bytes",
                &format!("sudo ip link set {} mtu 1500", self.interface),
            )
            .lasting("mtu 1500 in the profile of NetworkManager, or in /etc/network/interfaces"),
        }
    }
}
