//! What is in the files.

use super::facts::{Board, Facts, kernel};
use super::paths::{Paths, own};
use crate::doctor::port::Coalescing;
use crate::uid::mac_text;
use std::net::Ipv4Addr;

/// A file to write.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct File {
    /// Where.
    pub path: String,
    /// What.
    pub text: String,
    /// Its rights.
    pub mode: u32,
}

/// What is in them.
pub struct Content<'c> {
    /// The computer.
    pub facts: &'c Facts,
    /// The port's address.
    pub address: Ipv4Addr,
    /// The boards at it.
    pub boards: &'c [Board],
}

impl Content<'_> {
    fn interface(&self) -> &str {
        &self.facts.interface
    }

    fn head(&self) -> String {
        let interface = self.interface();
        format!(
            "# Written by `ferrocnc net setup {interface}`; `ferrocnc net remove {interface}` takes it away.\n"
        )
    }

    /// Settings of the kernel, which systemd makes when the port appears.
    pub fn kernel(&self) -> String {
        let mut text = self.head();
        for (key, value) in kernel(self.interface()) {
            if self.facts.kernel.contains_key(&key) {
                text += &format!("{key} = {value}\n");
            }
        }
        text
    }

    /// The egress rule. The boards' net is first, because the exchange waits for what is before it.
    pub fn egress(&self) -> String {
        let (interface, own) = (self.interface(), own(self.interface()));
        let [a, b, c, _] = self.address.octets();
        format!(
            "{head}# Only what is for boards leaves {interface}.
table netdev {own}
delete table netdev {own}
table netdev {own} {{
    chain egress {{
        type filter hook egress device \"{interface}\" priority 0; policy drop;
        ip daddr {a}.{b}.{c}.0/24 ip daddr != {a}.{b}.{c}.255 accept
        ether type arp accept
        # ferrocnc discover
        ip daddr 255.255.255.255 udp dport {discovery} accept
        # NAME.local, as ferrocnc asks for it; announcements of others have this port at both ends
        ip daddr 224.0.0.251 udp sport != 5353 udp dport 5353 accept
    }}
}}
",
            head = self.head(),
            discovery = wire::DISCOVERY_PORT,
        )
    }

    /// Commands that tell the kernel boards' hardware addresses.
    fn neighbours(&self) -> impl Iterator<Item = String> {
        self.boards.iter().map(|board| {
            format!(
                "ip neigh replace {} lladdr {} nud permanent dev {}",
                board.ip,
                mac_text(board.mac),
                self.interface()
            )
        })
    }

    /// The port in `/etc/network/interfaces.d`.
    pub fn stanza(&self) -> String {
        let interface = self.interface();
        let mut text = self.head();
        text += &format!(
            "auto {interface}\niface {interface} inet static\n    address {}/24\n",
            self.address
        );
        if let Some(off) = self.facts.coalescing.off() {
            text += "    # The card holds no frame back to save interrupts; not every card can.\n";
            text += &format!("    up ethtool -C {interface} {off} || true\n");
        }
        for neighbour in self.neighbours() {
            text += &format!("    up {neighbour}\n");
        }
        let paths = Paths::of(interface);
        text += &format!("    up nft -f /{}\n", paths.egress);
        text += &format!(
            "    down nft delete table netdev {} || true\n",
            own(interface)
        );
        text
    }

    /// The port in NetworkManager.
    pub fn profile(&self) -> String {
        let interface = self.interface();
        let mut text = self.head();
        text += &format!(
            "[connection]\nid={}\ntype=ethernet\ninterface-name={interface}\nautoconnect=true\n",
            own(interface)
        );
        // Ahead of the connection that NetworkManager makes of every port by itself.
        text += "autoconnect-priority=100\n\n[ethernet]\n\n";
        let Coalescing { adaptive, usecs } = self.facts.coalescing;
        if adaptive.is_some() || usecs.is_some() {
            text += "[ethtool]\n";
            if adaptive.is_some() {
                text += "coalesce-adaptive-rx=0\n";
            }
            if usecs.is_some() {
                text += "coalesce-rx-usecs=0\n";
            }
            text += "\n";
        }
        text += &format!(
            "[ipv4]\nmethod=manual\naddress1={}/24\nnever-default=true\n\n[ipv6]\nmethod=disabled\n",
            self.address
        );
        text
    }

    /// What NetworkManager runs with the name of a port and what it does.
    pub fn dispatcher(&self) -> String {
        let (interface, paths) = (self.interface(), Paths::of(self.interface()));
        let neighbours: String = self
            .neighbours()
            .map(|line| format!("    {line}\n"))
            .collect();
        format!(
            "#!/bin/sh\n{head}set -e\ncase \"$1 $2\" in\n\"{interface} up\")\n{neighbours}    nft -f /{egress}\n    ;;\n\"{interface} down\")\n    nft delete table netdev {own} 2>/dev/null || true\n    ;;\nesac\n",
            head = self.head(),
            egress = paths.egress,
            own = own(interface),
        )
    }
}
