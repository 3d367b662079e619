//! `enable-request`: one rising edge at the pin becomes one rising edge on the wire.
//!
//! An edge is an event, and a datagram may be lost. So the request stays set until the board has
//! accepted a command with it and the next command, which arms the machine. Then the request is
//! over, even if the pin stays high. A pin that is already high at load or when a session comes
//! back is not an edge: the machine never re-arms silently.

/// The request ends when the board accepts this many commands after the first one that carried it:
/// the edge, the command that arms, one in reserve.
const COMMANDS: u32 = 2;

/// The request on its way to the board.
#[derive(Debug)]
pub struct ArmRequest {
    pin: bool,
    asking: bool,
    carried_from: Option<u32>,
    arrived: bool,
}

impl Default for ArmRequest {
    fn default() -> Self {
        ArmRequest {
            // As if it had always been high: only a fall and a rise make an edge.
            pin: true,
            asking: false,
            carried_from: None,
            arrived: false,
        }
    }
}

impl ArmRequest {
    /// The wire's `enable-request` for the command with this sequence number. Without `ready` (the
    /// configuration is still on its way, or `enable` is false) a request waits as long as the pin
    /// is held; one that was under way ends.
    pub fn flag(&mut self, pin: bool, ready: bool, sequence: u32) -> bool {
        if pin && !self.pin {
            self.asking = true;
            self.carried_from = None;
            self.arrived = false;
        }
        self.pin = pin;
        let under_way = self.carried_from.is_some();
        if self.arrived || (!ready && (under_way || !pin)) {
            self.asking = false;
        }
        let flag = self.asking && ready;
        if flag {
            self.carried_from.get_or_insert(sequence);
        }
        flag
    }

    /// The board accepted the command with this sequence number.
    pub fn accepted(&mut self, sequence: u32) {
        if let Some(first) = self.carried_from {
            self.arrived |= sequence.wrapping_sub(first) as i32 >= COMMANDS as i32;
        }
    }

    /// A request that cannot be granted is over, even if the pin stays high; `true` if it is new.
    pub fn refuse(&mut self, pin: bool) -> bool {
        let edge = pin && !self.pin;
        self.pin = pin;
        self.forget();
        edge
    }

    /// The session is a new one; the request, if any, was for the old.
    pub fn forget(&mut self) {
        *self = ArmRequest {
            pin: self.pin,
            asking: false,
            carried_from: None,
            arrived: false,
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pin_that_is_high_at_load_is_no_edge() {
        let mut request = ArmRequest::default();
        assert!(!request.flag(true, true, 1));
        assert!(!request.flag(false, true, 2));
        assert!(request.flag(true, true, 3));
    }

    #[test]
    fn a_short_pulse_is_repeated_until_the_board_has_had_time_to_arm() {
        let mut request = ArmRequest::default();
        request.flag(false, true, 1);
        assert!(request.flag(true, true, 2));
        for sequence in 1..4 {
            request.accepted(sequence);
            assert!(request.flag(false, true, sequence + 2), "{sequence}");
        }
        request.accepted(4);
        assert!(!request.flag(false, true, 6));
    }

    #[test]
    fn a_held_pin_is_one_edge() {
        let mut request = ArmRequest::default();
        request.flag(false, true, 1);
        assert!(request.flag(true, true, 2));
        request.accepted(9);
        for sequence in 10..20 {
            assert!(!request.flag(true, true, sequence));
        }
        assert!(!request.flag(false, true, 20));
        assert!(request.flag(true, true, 21));
    }

    #[test]
    fn a_request_under_way_ends_when_enable_falls_and_does_not_come_back_with_it() {
        let mut request = ArmRequest::default();
        request.flag(false, true, 1);
        assert!(request.flag(true, true, 2));
        assert!(!request.flag(true, false, 3));
        assert!(!request.flag(true, true, 4));
    }

    #[test]
    fn a_held_pin_survives_no_new_session() {
        let mut request = ArmRequest::default();
        request.flag(false, true, 1);
        assert!(request.flag(true, true, 2));
        request.forget();
        assert!(!request.flag(true, true, 3));
        assert!(!request.flag(false, true, 4));
        assert!(request.flag(true, true, 5));
    }

    #[test]
    fn a_refused_request_is_told_once_and_used_up() {
        let mut request = ArmRequest::default();
        request.refuse(false);
        assert!(request.refuse(true));
        assert!(!request.refuse(true));
        assert!(!request.flag(true, true, 1));
        request.flag(false, true, 2);
        assert!(request.flag(true, true, 3));
    }

    #[test]
    fn a_request_waits_for_the_configuration_while_the_pin_is_held() {
        let mut request = ArmRequest::default();
        request.flag(false, false, 1);
        assert!(!request.flag(true, false, 2));
        assert!(request.flag(true, true, 3));
    }

    #[test]
    fn a_request_that_no_board_could_receive_ends_with_the_pin() {
        let mut request = ArmRequest::default();
        request.flag(false, false, 1);
        request.flag(true, false, 2);
        request.flag(false, false, 3);
        assert!(!request.flag(false, true, 4));
    }
}
