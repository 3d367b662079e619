//! Where the files of a port are, below the root, and what they are called.

/// Debian's file of ports.
pub const INTERFACES: &str = "etc/network/interfaces";

/// The name of our own that files and connections have.
pub fn own(interface: &str) -> String {
    format!("ferrocnc-{interface}")
}

/// Where the files of a port are.
#[derive(Clone, Debug)]
pub struct Paths {
    /// What undoes the setup.
    pub record: String,
    /// Settings of the kernel.
    pub kernel: String,
    /// The egress rule.
    pub egress: String,
    /// The port in Debian's ifupdown.
    pub stanza: String,
    /// The port in NetworkManager.
    pub profile: String,
    /// What NetworkManager runs when a port comes or goes.
    pub dispatcher: String,
}

impl Paths {
    /// Those of this one.
    pub fn of(interface: &str) -> Self {
        let own = own(interface);
        Paths {
            record: format!("var/lib/ferrocnc/net-{interface}.json"),
            kernel: format!("etc/sysctl.d/60-{own}.conf"),
            egress: format!("etc/ferrocnc/net-{interface}.nft"),
            stanza: format!("{INTERFACES}.d/{own}"),
            profile: format!("etc/NetworkManager/system-connections/{own}.nmconnection"),
            dispatcher: format!("etc/NetworkManager/dispatcher.d/{own}"),
        }
    }

    /// All but the record.
    pub fn all(&self) -> [&str; 5] {
        [
            &self.kernel,
            &self.egress,
            &self.stanza,
            &self.profile,
            &self.dispatcher,
        ]
    }
}
