//! The registers that the driver uses: one method, one access.
//!
//! Names and meanings are those of the ESP32-S3's technical reference manual, chapter 37. Three of
//! them are traps:
//!
//! - Fields of CHnCONF0 and CHnTX_LIM, and TX_STOP, take effect with CONF_UPDATE only.
//! - Without IDLE_OUT_EN the level after the end of a stream is indeterminate (erratum RMT-176).
//! - CARRIER_EN is set after a reset.

/// Fields of CHnCONF0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChannelConfig {
    /// DIV_CNT: clock cycles of a tick.
    pub divider: u8,
    /// MEM_SIZE: blocks that the channel has, from its own on.
    pub blocks: u8,
    /// MEM_TX_WRAP_EN: behind the last word comes the first.
    pub wrap: bool,
    /// TX_CONTI_MODE: behind the end marker comes the first word.
    pub continuous: bool,
    /// IDLE_OUT_EN: the level at rest is `idle_high`.
    pub idle_output: bool,
    /// IDLE_OUT_LV.
    pub idle_high: bool,
    /// CARRIER_EN.
    pub carrier: bool,
}

/// Fields of CHnSTATUS.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChannelStatus {
    /// MEM_RADDR_EX: the word that is read, counted from the first of the whole RAM.
    pub read_word: usize,
    /// STATE is 0: nothing is transmitted.
    pub idle: bool,
}

/// What has happened since it was cleared; bit n is channel n.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Events {
    /// The threshold was reached.
    pub reached: u8,
    /// The end marker was reached.
    pub ended: u8,
}

/// The pulse hardware: the RMT, and what surrounds it at the pins.
///
/// Sets of channels are masks: bit n is channel n.
pub trait Registers {
    /// Writes the fields of CHnCONF0. They take effect with [`Registers::update`].
    fn configure(&mut self, channel: usize, config: ChannelConfig);

    /// Writes CHnTX_LIM: after so many words there is an event. Takes effect with
    /// [`Registers::update`].
    fn set_threshold(&mut self, channel: usize, words: u16);

    /// Strobes CONF_UPDATE of CHnCONF0.
    fn update(&mut self, channel: usize);

    /// Writes REF_CNT_RST: the dividers of these channels begin a tick anew.
    fn reset_dividers(&mut self, channels: u8);

    /// Writes TX_SIM: these channels begin when the last of them is told to. 0: each by itself.
    fn start_together(&mut self, channels: u8);

    /// Strobes MEM_RD_RST, APB_MEM_RST and then TX_START of CHnCONF0.
    fn begin(&mut self, channel: usize);

    /// Strobes TX_STOP of CHnCONF0. Takes effect with [`Registers::update`].
    fn stop(&mut self, channel: usize);

    /// Reads CHnSTATUS.
    fn status(&self, channel: usize) -> ChannelStatus;

    /// Reads INT_RAW: the channels whose end marker was reached since
    /// [`Registers::clear_events`].
    fn ended(&self) -> u8;

    /// Reads INT_RAW: the channels whose threshold was reached, and whose end marker was, since
    /// [`Registers::clear_events`]. One access where the chip has both in one register.
    fn events(&self) -> Events;

    /// Writes INT_CLR: the threshold events of these channels, and their ends too if `ends`.
    fn clear_events(&mut self, channels: u8, ends: bool);

    /// Writes INT_ENA: thresholds and ends of these channels interrupt, those of others do not.
    fn enable_interrupts(&mut self, channels: u8);

    /// Writes a word of the RMT's RAM, counted from the first of the whole RAM.
    fn write_word(&mut self, word: usize, value: u32);

    /// Returns the level of the channel's step pin.
    fn step_pin(&self, channel: usize) -> bool;

    /// Sets the direction pin of an axis.
    fn set_direction(&mut self, axis: usize, positive: bool);

    /// Reads the pulse counter of an axis: active edges with sign, modulo 2¹⁶. `None` where the
    /// chip has none.
    fn counter(&self, axis: usize) -> Option<i16>;

    /// Returns the time: ticks of 62.5 ns (16 MHz) since boot. It comes from the same crystal as
    /// the RMT's clock.
    fn now(&self) -> u64;
}
