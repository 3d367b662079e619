//! dnsmasq gives a board its address, again and again, and is gone one day.

use crate::rig::*;
use ferrocnc_tests::Simulator;
use ferrocnc_tests::flash::{UID, factory};
use ferrocnc_tests::lan::Lan;
use ferrocnc_tests::lan::dhcp::DhcpServer;
use sim::nor::Part;

/// Nanoseconds of the board in one second: 20 times as fast as real time, for a lease has at least
/// two minutes.
const PACE: &str = "20e9";
/// The board renews behind half a lease.
const RENEWALS: usize = 2;

/// The messages of the log, with their kind only: `DHCPACK(eth0) 10.7.0.50 ..` is `DHCPACK`.
pub fn kinds(said: &str) -> Vec<&str> {
    let messages = said.lines().filter_map(|line| {
        let at = line.find("DHCP")?;
        line[at..].split_once("(eth0)").map(|(kind, _)| kind)
    });
    let kinds = [
        "DHCPDISCOVER",
        "DHCPOFFER",
        "DHCPREQUEST",
        "DHCPACK",
        "DHCPNAK",
    ];
    messages.filter(|kind| kinds.contains(kind)).collect()
}

/// The address of the last acknowledgement.
pub fn leased(said: &str) -> Option<String> {
    let mut lines = said.lines().rev();
    let line = lines.find(|line| line.contains("DHCPACK(eth0) "))?;
    let (_, rest) = line.split_once("DHCPACK(eth0) ")?;
    rest.split(' ').next().map(str::to_owned)
}

#[test]
fn a_lease_is_renewed_and_when_it_is_over_the_board_is_at_its_static_address() {
    let folder = Folder::new("leases");
    let nor = factory(Part::W25Q32JV, UID);
    let flash = flash_file(&folder, nor, "lathe", true)
        .display()
        .to_string();
    let mut lan = Lan::new();
    let host = lan.plug(Some("10.7.0.1/24"));
    host.ip("address add 192.168.2.1/24 dev eth0");
    let server = DhcpServer::start(&host, folder.path(), "2m");
    let uid = format!("{UID:016x}");
    let arguments = ["--flash", &flash, "--uid", &uid, "--pace", PACE];
    let _board = Simulator::on_cable(&mut lan, "mill6", &arguments);
    let acknowledged = |server: &DhcpServer, count: usize| {
        until("acknowledgements", || {
            let said = server.said();
            let kinds = kinds(&said);
            let acks = kinds.iter().filter(|kind| **kind == "DHCPACK").count();
            if acks >= count { Ok(()) } else { Err(said) }
        });
    };
    acknowledged(&server, 1);
    let ip = leased(&server.said()).expect("an address");
    let answers = |ip: &str| {
        let answer = curl(
            &host,
            &format!("http://{ip}/status.json"),
            &["--max-time", "2"],
        )?;
        match answer.content.contains(&format!("\"ip\":\"{ip}\"")) {
            true => Ok(()),
            false => Err(format!("{answer:?}")),
        }
    };
    until("the leased address", || answers(&ip));
    acknowledged(&server, 1 + RENEWALS);
    let said = server.said();
    let all = kinds(&said);
    let last = all.iter().rposition(|kind| *kind == "DHCPDISCOVER");
    let renewals = &all[last.expect("a beginning")..];
    let begins = ["DHCPDISCOVER", "DHCPOFFER", "DHCPREQUEST", "DHCPACK"];
    assert!(renewals.starts_with(&begins), "{said}");
    for renewal in renewals[begins.len()..].chunks_exact(2) {
        assert_eq!(renewal, ["DHCPREQUEST", "DHCPACK"], "{said}");
    }
    assert_eq!(leased(&said).as_ref(), Some(&ip), "{said}");
    assert!(said.contains(&format!("{ip} {} lathe", mac())), "{said}");
    until("the leased address", || answers(&ip));

    // The server is gone, and with its last lease the address.
    drop(server);
    until("the static address", || answers("192.168.2.50"));
    assert!(answers(&ip).is_err(), "it has two addresses");
    // It is back: the board has not stopped to ask.
    let server = DhcpServer::start(&host, folder.path(), "2m");
    acknowledged(&server, 1);
    let ip = leased(&server.said()).expect("an address");
    until("the address of the new lease", || answers(&ip));
}
