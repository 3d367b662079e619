//! Enums that are numbers on the wire and words in text.

/// An enum with a wire code of the given type and a text per value; an unknown code is `None`.
macro_rules! codes {
    ($(#[$meta:meta])* $name:ident: $code:ty { $($(#[doc = $doc:literal])+ $variant:ident = $value:literal, $text:literal;)+ }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        #[repr(u8)]
        pub enum $name { $($(#[doc = $doc])+ $variant = $value),+ }

        impl $name {
            /// All of them, in wire order.
            pub const ALL: &'static [$name] = &[$($name::$variant),+];

            /// The one with this wire code, if there is one.
            pub const fn from_code(code: $code) -> Option<Self> {
                match code { $($value => Some($name::$variant),)+ _ => None }
            }

            /// Its wire code.
            pub const fn code(self) -> $code {
                self as $code
            }

            /// Its text.
            pub const fn text(self) -> &'static str {
                match self { $($name::$variant => $text),+ }
            }
        }

        impl core::fmt::Display for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                f.write_str(self.text())
            }
        }
    };
}

pub(crate) use codes;

#[cfg(test)]
mod tests {
    use crate::flash::{Op, OpResult, Origin, Running, Slot};
    use crate::{FaultReason, GateClose, LinkSpeed, ResetReason, State};

    #[test]
    fn every_code_is_its_own_values_and_no_other() {
        macro_rules! every {
            ($($name:ident),+) => {$(
                for value in $name::ALL {
                    assert_eq!($name::from_code(value.code()), Some(*value), "{value}");
                }
                let known = (0..=255).filter(|code| $name::from_code(*code).is_some()).count();
                assert_eq!(known, $name::ALL.len(), stringify!($name));
            )+};
        }
        every!(
            State,
            FaultReason,
            ResetReason,
            GateClose,
            LinkSpeed,
            Op,
            OpResult,
            Slot,
            Running,
            Origin
        );
    }
}
