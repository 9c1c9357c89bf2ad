//! What a node keeps in flash.
//!
//! The fields are postcard in this order and are only ever appended: a record of an older firmware
//! is read by a newer one, whose new fields take their defaults.

use crate::{
    machine::{Machine, SwitchSettings},
    tuning::{FilterSettings, HomingSettings, PlacesC, ReachSettings, Tuning, WayD},
    wiring::{PinSetting, PinUse, Wiring},
};
use heapless::{String, Vec};
use keys::{AXES_MAX, NodeId};
use motion::{AxisProfile, limits::CHANNELS};
use serde::{Deserialize, Serialize};

/// Networks that a node knows.
pub const NETWORKS_MAX: usize = 4;

/// Longest name of a network, bytes (IEEE 802.11).
pub const SSID_BYTES_MAX: usize = 32;

/// Longest password, bytes: WPA2 takes 63.
pub const PASSWORD_BYTES_MAX: usize = 63;

/// Longest locator of a router, bytes.
pub const ROUTER_BYTES_MAX: usize = 64;

/// Longest user name, bytes.
pub const USER_BYTES_MAX: usize = 32;

/// Most keys of operators that a node knows.
pub const SIGNERS_MAX: usize = 8;

/// Longest name of an authority, bytes of DER.
pub const AUTHORITY_SUBJECT_BYTES_MAX: usize = 128;

/// Longest key of an authority, bytes of DER.
pub const AUTHORITY_KEY_BYTES_MAX: usize = 96;

/// Most bytes of a record.
pub const RECORD_BYTES_MAX: usize = 2_048;

/// A WiFi network.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Network {
    /// Its name.
    pub ssid: String<SSID_BYTES_MAX>,
    /// Its password; empty for an open network.
    pub password: String<PASSWORD_BYTES_MAX>,
}

/// What a zenoh router wants to know.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Login {
    /// User.
    pub user: String<USER_BYTES_MAX>,
    /// Password.
    pub password: String<PASSWORD_BYTES_MAX>,
}

/// Who must have signed the router's certificate: what counts of an authority's own one.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Authority {
    /// Its name, DER without the outer tag.
    pub subject: Vec<u8, AUTHORITY_SUBJECT_BYTES_MAX>,
    /// Its public key, DER of SubjectPublicKeyInfo without the outer tag.
    pub key: Vec<u8, AUTHORITY_KEY_BYTES_MAX>,
}

/// An address instead of DHCP.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FixedAddress {
    /// The node's own.
    pub address: [u8; 4],
    /// Bits of the network, 0 to 32.
    pub prefix_bits: u8,
    /// Where everything else is.
    pub gateway: [u8; 4],
}

/// What the driver of an axis demands: see [`AxisProfile`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AxisSettings {
    /// Shortest high time of a step, ns.
    pub high_ns_min: u32,
    /// Shortest low time between steps, ns.
    pub low_ns_min: u32,
    /// High time of slow steps, ns.
    pub high_ns: u32,
    /// From a change of direction to the next step, ns.
    pub dir_setup_ns: u32,
    /// From a step to a change of direction, ns.
    pub dir_hold_ns: u32,
    /// Deceleration of a controlled stop, steps/s².
    pub stop_accel_hz_per_s: u32,
    /// Most that the speed jumps at a corner, Hz.
    pub junction_hz: u32,
    /// Whether the direction pin is low for positive.
    pub direction_inverted: bool,
}

impl Default for AxisSettings {
    fn default() -> Self {
        Self::from(AxisProfile::default())
    }
}

impl From<AxisProfile> for AxisSettings {
    fn from(profile: AxisProfile) -> Self {
        Self {
            high_ns_min: profile.high_ns_min,
            low_ns_min: profile.low_ns_min,
            high_ns: profile.high_ns,
            dir_setup_ns: profile.dir_setup_ns,
            dir_hold_ns: profile.dir_hold_ns,
            stop_accel_hz_per_s: profile.stop_accel_hz_per_s,
            junction_hz: profile.junction_hz,
            direction_inverted: profile.direction_inverted,
        }
    }
}

impl From<AxisSettings> for AxisProfile {
    fn from(settings: AxisSettings) -> Self {
        Self {
            high_ns_min: settings.high_ns_min,
            low_ns_min: settings.low_ns_min,
            high_ns: settings.high_ns,
            dir_setup_ns: settings.dir_setup_ns,
            dir_hold_ns: settings.dir_hold_ns,
            stop_accel_hz_per_s: settings.stop_accel_hz_per_s,
            junction_hz: settings.junction_hz,
            direction_inverted: settings.direction_inverted,
        }
    }
}

/// Everything that a node is told.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Record {
    /// Its name; a node without one has not been told anything.
    pub name: Option<NodeId>,
    /// Prefix of the fleet's keys; empty: the default.
    pub prefix: String<{ keys::key::PREFIX_BYTES_MAX }>,
    /// Networks, the preferred one first.
    pub networks: Vec<Network, NETWORKS_MAX>,
    /// Address instead of DHCP.
    pub fixed_address: Option<FixedAddress>,
    /// Where the router is, `tcp/HOST:PORT` or `tls/HOST:PORT`; empty: it is found by scouting.
    pub router: String<ROUTER_BYTES_MAX>,
    /// What the router wants to know.
    pub login: Option<Login>,
    /// The axes; none: the board's default.
    pub axes: Vec<AxisSettings, AXES_MAX>,
    /// Public key (ed25519) that updates must be signed with; none: no updates over the network.
    pub update_key: Option<[u8; 32]>,
    /// Whether the stored script `boot` runs when the node starts.
    pub boot_script: bool,
    /// Public keys (ed25519) of operators: the node executes only what one of them has signed; none:
    /// whatever its gateway sends.
    pub signers: Vec<[u8; 32], SIGNERS_MAX>,
    /// What is connected beside the drivers.
    pub machine: Machine,
    /// How it moves by itself.
    pub tuning: Tuning,
    /// Who must have signed the router's certificate; with one the node speaks TLS only, without one
    /// it does not.
    pub authority: Option<Authority>,
    /// How many axes, and which pins.
    pub wiring: Wiring,
}

/// One change of a record. Appended to, never changed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Setting {
    /// Begins with an empty record.
    Clear,
    /// The node's name.
    Name(NodeId),
    /// Prefix of the fleet's keys.
    Prefix(String<{ keys::key::PREFIX_BYTES_MAX }>),
    /// One more network, or another password of one that is known.
    Network(Network),
    /// Forgets all networks.
    NoNetworks,
    /// Address; `None`: DHCP.
    FixedAddress(Option<FixedAddress>),
    /// Where the router is; empty: scouting.
    Router(String<ROUTER_BYTES_MAX>),
    /// What the router wants to know.
    Login(Option<Login>),
    /// One axis; those below it exist too.
    Axis {
        /// Its number.
        axis: u8,
        /// What its driver demands.
        settings: AxisSettings,
    },
    /// Key for updates.
    UpdateKey(Option<[u8; 32]>),
    /// Whether the stored script `boot` runs when the node starts.
    BootScript(bool),
    /// One more operator whose signature counts; one that is known is no error.
    Signer([u8; 32]),
    /// Forgets all operators: the node executes whatever its gateway sends.
    NoSigners,
    /// One more switch, or other settings of one that is known.
    Switch(SwitchSettings),
    /// Forgets all switches.
    NoSwitches,
    /// Whether C and D are there.
    HasCd(bool),
    /// Whether the lidar is there.
    HasLidar(bool),
    /// How an axis is homed.
    Homing(HomingSettings),
    /// How far an axis may go.
    Reach(ReachSettings),
    /// How long a switch must hold a level.
    Filter(FilterSettings),
    /// The places of C; `None`: motion's defaults.
    PlacesC(Option<PlacesC>),
    /// The way of D; `None`: motion's default.
    WayD(Option<WayD>),
    /// Forgets all five.
    NoTuning,
    /// Who must have signed the router's certificate; `None`: no TLS.
    Authority(Option<Authority>),
    /// How many axes; 0: as by default.
    Axes(u8),
    /// Another pin than the kit's.
    Pin(PinSetting),
    /// Forgets all pins: the kit's.
    NoPins,
}

/// A setting does not fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SettingError {
    /// [`NETWORKS_MAX`] are known already.
    Networks,
    /// The network has no name, or a password of 1 to 7 bytes, which WPA2 does not take.
    Network,
    /// No axis of this number.
    Axis,
    /// Not of the form `tcp/HOST:PORT` or `tls/HOST:PORT`.
    Router,
    /// The prefix is no key.
    Prefix,
    /// More than 32 bits of network.
    Address,
    /// [`SIGNERS_MAX`] are known already.
    Signers,
    /// There can be no such switch.
    Switch,
    /// No axis can be homed like this.
    Homing,
    /// There is nothing between two soft limits, or no such axis.
    Reach,
    /// There is no such switch, the filter is longer than motion takes, or there are too many.
    Filter,
    /// C's places are not in order, or too fast, or its metre has no steps.
    PlacesC,
    /// D has no way, no speed, or its metre no steps.
    WayD,
    /// The authority has no name or no key.
    Authority,
    /// A time of the driver is longer than motion plays, or none.
    Driver,
    /// More axes than any chip drives.
    Axes,
    /// There can be no such pin, or too many are told.
    Pin,
}

impl core::fmt::Display for SettingError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Networks => "Networks: it knows as many as it can",
            Self::Network => "Network: it has no name, or a password of 1 to 7 bytes",
            Self::Axis => "Axis: there is no such axis",
            Self::Router => "Router: it is tcp/HOST:PORT or tls/HOST:PORT",
            Self::Prefix => "Prefix: it is no key",
            Self::Address => "Address: a network has 0 to 32 bits",
            Self::Signers => "Signers: it knows as many as it can",
            Self::Switch => "Switch: there can be no such switch",
            Self::Homing => {
                "Homing: speeds are 1 to 200000 Hz, the approach no faster than the seek, \
                 acceleration and way at least 1"
            }
            Self::Reach => "Soft limits: there is nothing between them, or no such axis",
            Self::Filter => {
                "Filter: there is no such switch, the time is too long, or there are too many"
            }
            Self::PlacesC => {
                "Places of C: each is at least a step above the one before, and a speed makes 1 to \
                 200000 steps a second"
            }
            Self::WayD => "Way of D: it has a way, a speed and steps",
            Self::Authority => "Authority: it has no name or no key",
            Self::Driver => {
                "Driver: a step's parts are 1 to 2000000 ns, setup and hold 1 to 200000 ns, and a \
                 stop slows down by at least 1 step/s²"
            }
            Self::Axes => "Axes: there are 1 to 4",
            Self::Pin => "Pin: there can be no such pin, or too many are told",
        })
    }
}

impl core::error::Error for SettingError {}

impl Record {
    /// Applies a change.
    ///
    /// # Errors
    /// It does not fit; the record is as before.
    pub fn apply(&mut self, setting: Setting) -> Result<(), SettingError> {
        match setting {
            Setting::Clear => *self = Self::default(),
            Setting::Name(name) => self.name = Some(name),
            Setting::Prefix(prefix) => {
                if !prefix.is_empty() && keys::Keys::new(&prefix).is_err() {
                    return Err(SettingError::Prefix);
                }
                self.prefix = prefix;
            }
            Setting::Network(network) => {
                let password_bytes = network.password.len();
                if network.ssid.is_empty() || (1..8).contains(&password_bytes) {
                    return Err(SettingError::Network);
                }
                let known = self.networks.iter_mut().find(|of| of.ssid == network.ssid);
                match known {
                    Some(known) => *known = network,
                    None => {
                        let full = |_| SettingError::Networks;
                        self.networks.push(network).map_err(full)?;
                    }
                }
            }
            Setting::NoNetworks => self.networks.clear(),
            Setting::FixedAddress(address) => {
                if address.is_some_and(|address| address.prefix_bits > 32) {
                    return Err(SettingError::Address);
                }
                self.fixed_address = address;
            }
            Setting::Router(router) => {
                if !router.is_empty() && router_address(&router).is_none() {
                    return Err(SettingError::Router);
                }
                self.router = router;
            }
            Setting::Login(login) => self.login = login,
            Setting::Axis { axis, settings } => {
                let index = usize::from(axis);
                if index >= AXES_MAX {
                    return Err(SettingError::Axis);
                }
                if !settings.is_legal() {
                    return Err(SettingError::Driver);
                }
                while self.axes.len() <= index {
                    let full = |_| SettingError::Axis;
                    self.axes.push(AxisSettings::default()).map_err(full)?;
                }
                self.axes[index] = settings;
            }
            Setting::UpdateKey(key) => self.update_key = key,
            Setting::BootScript(allowed) => self.boot_script = allowed,
            Setting::Signer(key) => {
                if !self.signers.contains(&key) {
                    self.signers.push(key).map_err(|_| SettingError::Signers)?;
                }
            }
            Setting::NoSigners => self.signers.clear(),
            Setting::Switch(settings) => {
                if !settings.is_legal() || !self.machine.add(settings) {
                    return Err(SettingError::Switch);
                }
            }
            Setting::NoSwitches => self.machine.switches.clear(),
            Setting::HasCd(has) => self.machine.has_cd = has,
            Setting::HasLidar(has) => self.machine.has_lidar = has,
            Setting::Homing(homing) => {
                demand(self.tuning.set_homing(homing), SettingError::Homing)?;
            }
            Setting::Reach(reach) => demand(self.tuning.set_reach(reach), SettingError::Reach)?,
            Setting::Filter(filter) => {
                demand(self.tuning.set_filter(filter), SettingError::Filter)?;
            }
            Setting::PlacesC(places) => {
                let legal = places.is_none_or(|places| places.is_legal());
                demand(legal, SettingError::PlacesC)?;
                self.tuning.c = places;
            }
            Setting::WayD(way) => {
                demand(way.is_none_or(|way| way.is_legal()), SettingError::WayD)?;
                self.tuning.d = way;
            }
            Setting::NoTuning => self.tuning = Tuning::default(),
            Setting::Authority(authority) => {
                let is_empty = |of: &Authority| of.subject.is_empty() || of.key.is_empty();
                if authority.as_ref().is_some_and(is_empty) {
                    return Err(SettingError::Authority);
                }
                self.authority = authority;
            }
            Setting::Axes(count) => {
                demand(usize::from(count) <= CHANNELS, SettingError::Axes)?;
                self.wiring.axis_count = count;
            }
            Setting::Pin(pin) => {
                // Whoever has no button still has a wire: a node that nothing stops is none.
                let is_needed = pin.of == PinUse::Stop && pin.gpio.is_none();
                demand(!is_needed && self.wiring.set(pin), SettingError::Pin)?;
            }
            Setting::NoPins => self.wiring.pins.clear(),
        }
        Ok(())
    }

    /// Returns whether the node can take part in a fleet.
    pub fn is_complete(&self) -> bool {
        self.name.is_some() && !self.networks.is_empty() && self.is_consistent()
    }

    /// Returns whether router and authority go together: TLS needs somebody to trust, and a node that
    /// was told whom to trust does not speak in the open, wherever its router's address came from.
    pub fn is_consistent(&self) -> bool {
        self.authority.is_some() == wants_tls(&self.router)
    }
}

fn demand(legal: bool, error: SettingError) -> Result<(), SettingError> {
    if legal { Ok(()) } else { Err(error) }
}

/// Returns host and port of a locator `tcp/HOST:PORT` or `tls/HOST:PORT`.
pub fn router_address(locator: &str) -> Option<(&str, u16)> {
    let (protocol, address) = locator.split_once('/')?;
    let (host, port) = address.rsplit_once(':')?;
    let port = port.parse().ok().filter(|port| *port != 0)?;
    (!host.is_empty() && matches!(protocol, "tcp" | "tls")).then_some((host, port))
}

/// Returns whether a locator asks for TLS.
pub fn wants_tls(locator: &str) -> bool {
    locator.starts_with("tls/")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::{End, SwitchOf};

    fn text<const N: usize>(text: &str) -> String<N> {
        String::try_from(text).expect("short")
    }

    #[test]
    fn a_setting_that_does_not_fit_changes_nothing() {
        let mut record = Record::default();
        for number in 0..NETWORKS_MAX {
            let mut ssid = text("shop-");
            ssid.push(char::from(b'a' + number as u8)).expect("short");
            let network = Network {
                ssid,
                password: text("12345678"),
            };
            record.apply(Setting::Network(network)).expect("fits");
        }
        let before = record.clone();
        let network = |ssid, password| {
            Setting::Network(Network {
                ssid: text(ssid),
                password: text(password),
            })
        };
        for (setting, error) in [
            (network("one-more", ""), SettingError::Networks),
            (network("shop-a", "1234567"), SettingError::Network),
            (network("", ""), SettingError::Network),
            (Setting::Router(text("udp/a:1")), SettingError::Router),
            (Setting::Router(text("tcp/a:0")), SettingError::Router),
            (Setting::Prefix(text("a//b")), SettingError::Prefix),
            (
                Setting::Axis {
                    axis: AXES_MAX as u8,
                    settings: AxisSettings::default(),
                },
                SettingError::Axis,
            ),
        ] {
            assert_eq!(record.apply(setting), Err(error));
        }
        assert_eq!(record, before);
        record
            .apply(network("shop-b", "another one"))
            .expect("is known");
        assert_eq!(record.networks.len(), NETWORKS_MAX);
    }

    #[test]
    fn operators_are_told_one_by_one_and_forgotten_all_at_once() {
        let mut record = Record::default();
        for key in 0..SIGNERS_MAX as u8 {
            record.apply(Setting::Signer([key; 32])).expect("fits");
            record.apply(Setting::Signer([0; 32])).expect("is known");
        }
        let full = record.apply(Setting::Signer([99; 32]));
        assert_eq!(full, Err(SettingError::Signers));
        assert_eq!(record.signers.len(), SIGNERS_MAX);
        record.apply(Setting::NoSigners).expect("always");
        assert_eq!(record, Record::default());
    }

    #[test]
    fn a_router_by_tls_and_an_authority_need_each_other() {
        let mut record = Record {
            name: Some(NodeId::new("left").expect("legal")),
            ..Record::default()
        };
        let network = Network {
            ssid: text("shop"),
            ..Network::default()
        };
        record.apply(Setting::Network(network)).expect("fits");
        assert!(record.is_complete());
        let authority = Authority {
            subject: Vec::from_slice(b"s").expect("short"),
            key: Vec::from_slice(b"k").expect("short"),
        };
        for (router, told, is_complete) in [
            ("tls/plant:7447", false, false),
            ("tls/plant:7447", true, true),
            ("tcp/plant:7448", true, false),
            ("", true, false),
            ("tcp/plant:7448", false, true),
        ] {
            record.apply(Setting::Router(text(router))).expect("legal");
            let authority = told.then(|| authority.clone());
            record.apply(Setting::Authority(authority)).expect("legal");
            assert_eq!(record.is_complete(), is_complete, "{router} {told}");
        }
        let nobody = Setting::Authority(Some(Authority::default()));
        assert_eq!(record.apply(nobody), Err(SettingError::Authority));
    }

    #[test]
    fn the_largest_record_fits() {
        let mut record = Record {
            name: Some(NodeId::new("n".repeat_32().as_str()).expect("legal")),
            ..Record::default()
        };
        for _ in 0..keys::key::PREFIX_BYTES_MAX {
            record.prefix.push('p').expect("fits");
        }
        for number in 0..NETWORKS_MAX {
            let mut network = Network::default();
            for _ in 0..SSID_BYTES_MAX {
                network
                    .ssid
                    .push(char::from(b'a' + number as u8))
                    .expect("fits");
            }
            for _ in 0..PASSWORD_BYTES_MAX {
                network.password.push('p').expect("fits");
            }
            record.networks.push(network).expect("fits");
        }
        for _ in 0..ROUTER_BYTES_MAX {
            record.router.push('r').expect("fits");
        }
        let mut login = Login::default();
        for _ in 0..USER_BYTES_MAX {
            login.user.push('u').expect("fits");
        }
        for _ in 0..PASSWORD_BYTES_MAX {
            login.password.push('p').expect("fits");
        }
        record.login = Some(login);
        let most = AxisSettings {
            high_ns_min: u32::MAX,
            low_ns_min: u32::MAX,
            high_ns: u32::MAX,
            dir_setup_ns: u32::MAX,
            dir_hold_ns: u32::MAX,
            stop_accel_hz_per_s: u32::MAX,
            junction_hz: u32::MAX,
            direction_inverted: true,
        };
        while record.axes.push(most).is_ok() {}
        record.update_key = Some([0xff; 32]);
        while record.signers.push([0xff; 32]).is_ok() {}
        let switch = SwitchSettings {
            of: SwitchOf::Axis(0xff),
            end: End::Home,
            normally_closed: true,
            homes: true,
        };
        while record.machine.switches.push(switch).is_ok() {}
        let homing = HomingSettings {
            axis: 0xff,
            seek_hz: u32::MAX,
            approach_hz: u32::MAX,
            accel_hz_per_s: u32::MAX,
            travel_steps: u32::MAX,
            pull_off_steps: u32::MAX,
        };
        while record.tuning.homing.push(homing).is_ok() {}
        let reach = ReachSettings {
            axis: 0xff,
            min_steps: i32::MIN,
            max_steps: i32::MIN,
            from_boot: true,
        };
        while record.tuning.reach.push(reach).is_ok() {}
        let filter = FilterSettings {
            of: SwitchOf::Axis(0xff),
            end: End::Home,
            active_us: u32::MAX,
            inactive_us: u32::MAX,
        };
        while record.tuning.filters.push(filter).is_ok() {}
        record.tuning.c = Some(PlacesC {
            steps_per_m: u32::MAX,
            places: [(i32::MIN, u32::MAX); 5],
        });
        record.tuning.d = Some(WayD {
            steps_per_m: u32::MAX,
            travel_um: u32::MAX,
            speed_um_per_s: u32::MAX,
        });
        // The answer to who asks for it has a frame of its own.
        let mut answer = [0; crate::frame::FRAME_BYTES_MAX + 2];
        crate::frame::write(&crate::Reply::Tuning(record.tuning.clone()), &mut answer);
        let mut authority = Authority::default();
        while authority.subject.push(0xff).is_ok() {}
        while authority.key.push(0xff).is_ok() {}
        record.authority = Some(authority);
        record.wiring.axis_count = u8::MAX;
        let pin = PinSetting {
            of: PinUse::Switch {
                of: SwitchOf::C,
                end: End::Max,
            },
            gpio: Some(0xff),
        };
        while record.wiring.pins.push(pin).is_ok() {}
        crate::frame::write(&crate::Reply::Pins(record.wiring.clone()), &mut answer);
        let mut buffer = [0; 2 * RECORD_BYTES_MAX];
        let used = postcard::to_slice(&record, &mut buffer)
            .expect("room")
            .len();
        assert!(used <= RECORD_BYTES_MAX, "{used}");
    }

    trait Repeat {
        fn repeat_32(&self) -> String<32>;
    }

    impl Repeat for str {
        fn repeat_32(&self) -> String<32> {
            let mut text = String::new();
            while text.push_str(self).is_ok() {}
            text
        }
    }
}
