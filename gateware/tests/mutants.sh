#!/usr/bin/env bash
# Breaks the cores one way at a time and expects their bench to notice. By hand, minutes: a bench
# that cannot fail is worth nothing, but it need not prove that every day.
set -uo pipefail
here=$(cd "$(dirname "$0")" && pwd)
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
survived=0
only=${1:-}  # a bench's name

mutant() {  # bench file what sed-expression
    [ -z "$only" ] || [ "$only" = "$1" ] || return 0
    rm -rf "$scratch/rtl"
    cp -r "$here/../rtl" "$scratch/rtl"
    sed -i -E "$4" "$scratch/rtl/$2.sv"
    if cmp -s "$here/../rtl/$2.sv" "$scratch/rtl/$2.sv"; then
        echo "STALE    $1: $3 (nothing to change)"
        survived=1
        return
    fi
    if said=$(RTL=$scratch/rtl OUT=$scratch/out BOARD=mill6 timeout 300 "$here/run.sh" "$1" 1 2>&1); then
        echo "SURVIVED $1: $3"
        survived=1
    elif [ -z "$said" ]; then  # the time was up before the bench had said anything
        echo "SLOW     $1: $3 (nothing said in 300 s)"
        survived=1
    elif echo "$said" | grep -q "does not build"; then
        echo "BROKEN   $1: $3 (does not build)"
        survived=1
    else
        echo "caught   $1: $3 -- $(echo "$said" | tail -1 | cut -c1-110)"
    fi
}

mutant stepgen stepgen "steplen one short"              's/pulse \? steplen : stepspace/pulse ? steplen - 13'"'"'d1 : stepspace/'
mutant stepgen stepgen "stepspace forgotten"            's/pulse \? steplen : stepspace/pulse ? steplen : stepspace \& 13'"'"'d0/'
mutant stepgen stepgen "dirsetup not waited for"        's/ & ~\(setup & ~dir_done\);/;/'
mutant stepgen stepgen "dirhold not waited for"         's/\(setup \| dir_done\) & \(negative/(negative/'
mutant stepgen stepgen "a pulse in the old direction"   's/step_done & \(reverse == negative\)/step_done/'
mutant stepgen stepgen "a due pulse is lost"            's/if \(gate & \(~due \| ready\)\) fraction/if (gate) fraction/'
mutant stepgen stepgen "counts without a pulse"         's/else if \(emit\) delta/else if (gate \& due) delta/'
mutant stepgen stepgen "a visit loses the pulse of its clock" 's/if \(visit\) delta <= .*/if (visit) delta <= 5'"'"'d0;/'
mutant stepgen stepgen "a pulse at gate close"          's/ripe( +)= gate & due & ready/ripe\1= due \& ready/'
mutant stepgen stepgen "the ramp passes its target"     's/arrived = jump \| \(up \^ below\)/arrived = jump/'
mutant stepgen stepgen "the ramp learns nothing"        's/if \(fresh\) up <= below;/if (fresh) up <= 1'"'"'b1;/'
mutant stepgen stepgen "timers narrower than their registers" 's/setup \? dirsetup : dirhold;/(setup ? dirsetup : dirhold) \& 16'"'"'h0fff;/'
mutant stepgen stepgen "quadrature: both lines change"  's/(a_next +)= a \^ \(emit & .*\);/\1= a ^ emit;/'
mutant stepgen stepgen "up/down: pulses on both pins"  's/pulse_next & ~\(updown & reverse\)/pulse_next/'
mutant stepgen stepgen "a closed gate moves a quadrature line" 's/\(~gate & ~quadrature\)/~gate/'
mutant stepgen stepgen "time that stands moves the position" 's/ripe & advance/ripe/'
mutant stepgen stepgen "time that stands forgets a command" 's/fresh & ~advance & ~braking/1'"'"'b0/'
mutant stepgen stepgen "a stop waits for time"            's/~\(advance \| braking\)/~advance/'
mutant jobs segments "a segment with a word missing counts"  's/dead & whole & ~short/dead \& (whole | 1'"'"'b1) \& ~short/'
mutant jobs segments "a short segment counts"                's/whole & ~short/whole \& ~(short \& 1'"'"'b0)/'
mutant jobs segments "a full FIFO takes words"               's/< WORDS\) & ~full;/< WORDS);/'
mutant jobs segments "a refused push leaves its words"       's/if \(push \| dead\) seen/if (taken | dead) seen/'
mutant jobs segments "an underrun holds the velocity"        's/else if \(over & ~staged & ~first\)/else if (over \& ~staged \& ~first \& ~moves)/'
mutant jobs segments "an underrun is said to be done"        's/moves \? UNDERRUN : DONE/moves \& begun[0] ? UNDERRUN : DONE/'
mutant jobs segments "a segment a clock longer"              's/\{31.d0, commit, ~commit\}/33'"'"'d1/'
mutant jobs segments "a pause does not stop the duration"    's/\(~left\[32\] & advance\)/~left[32]/'
mutant jobs segments "time passes while a pulse waits"       's/tick & ~waits\)/tick)/'
mutant jobs segments "a segment begins in the clock of a stop" 's/over & ~breaks;/over;/'
mutant jobs segments "outputs switch when they are read"     's/else if \(state == IDLE & dead\) outputs/else if (fetched \& fetched_at == 1) outputs <= out[15:0]; else if (state == IDLE \& dead) outputs/'
mutant jobs segments "a pause leaves the beam on"            's/\(state != PLAY\) \| stands\}\}/(state != PLAY)}}/'
mutant jobs segments "begins before everything stands"       's/else if \(stopped\) state <= PLAY;/else state <= PLAY;/'
mutant jobs segments "ends before everything stands"         's/if \(stopped \| ~gate\) state <= IDLE;/state <= IDLE;/'
mutant jobs segments "goes on after an underrun"             's/wire dead   = failed \| ~gate;/wire dead   = ~gate;/'
mutant jobs segments "a pace passes its target"              's/there   = \(slew == 32.d0\) \| \(up \^ below\)/there   = slew == 32'"'"'d0/'
mutant jobs segments "a velocity forgotten by the underrun"  's/~stage_at\[0\] & out != 32.d0/~stage_at[0] \& out[31:1] != 31'"'"'d0/'
mutant encoder encoder "direction reversed"             's/up = a_now \^ b_was/up = ~(a_now ^ b_was)/'
mutant encoder encoder "x1 runs away on a jittering edge" 's/a_edge & ~b_edge & ~b_now/a_rise \& ~b_edge \& ~b_now/'
mutant encoder encoder "the mask is forgotten"          's/(m_sync \^ mode\[6\]\) \| ~mode\[5\])/\1 | 1'"'"'b1/'
mutant encoder debounce "filter one short"              's/long_enough = still == filter/long_enough = still + 1 >= filter/'
mutant latch latch "latches every index"                's/free( +)= ~\(index_flag \| probe_flag \| pending\)/free\1= ~pending/'
mutant latch latch "a level is an edge"                 's/index_was <= index \| ~arm_index/index_was <= index \& arm_index/'
mutant latch latch "a flag before its value"            's/arm_index & index_flag & ~pending/arm_index \& index_flag/'
mutant wide_counter wide_counter "a sample with the event of its clock's visit twice" 's/passed\[n\]        <= turn\[n\]/passed[n] <= 1'"'"'b0/'
mutant wide_counter wide_counter "a clear that clears the latch, too" 's/base_latch  <= total;/base_latch  <= |(clearing \& turn[CHANNELS-1:0]) ? 32'"'"'d0 : total;/'
mutant edges edges "an edge time one late"              's/ago = edge_at - behind,/ago = edge_at - behind + 4'"'"'d1,/'
mutant edges edges "an edge after the strobe in the sample" 's/\|seen_caught_shown \? time_caught/(|seen_shown | (|seen_caught_shown \& 1'"'"'b0)) ? time_new + (time_caught \& 24'"'"'d0)/'
mutant pwm pwm "width taken in mid-period"              's/ends  = \(count == this_width\)/ends  = (count == (commit ? width[28:8] : this_width))/'
mutant pwm pwm "period one long"                        's/last  = \(after == this_period\)/last  = (count == this_period)/'
mutant pwm pwm "a closed gate forgets nothing"          's/if \(~gate\) begin  \/\/ and the first/if (1'"'"'b0) begin  \/\/ and the first/'
mutant pwm pwm "both pins at once"                      's/plus  <= pulse & ~\(up_down & this_dir\)/plus  <= pulse/'
mutant pwm pwm "dither is a no-op"                      's/whole = low\[8\] & dither/whole = 1'"'"'b0 \& low[8] \& dither/'
mutant pwm pwm "full density misses a bit"              's/high\[16\] \| full/high[16] | (full \& high[15])/'
mutant timebase timebase "timed commit one late"        's/due  <= next >= commit_at/due  <= now >= commit_at/'
mutant timebase timebase "a replaced commit fires, too" 's/ & ~commit_timed\);/);/'
mutant gpio gpio "debounce one visit short"             's/differing & left\[16\];/differing \& (left[15:0] == 16'"'"'d0 | left[16]);/'
mutant gpio gpio "an e-stop does not latch"             's/clear \? 32.d0/(clear | ~estop) ? 32'"'"'d0/'
mutant gpio gpio "live before the first commit"         's/gate & \(live \| commit\)/gate/'
mutant pinmux crossbar "a source of the next group"     's/== 5.\(g\) \| \(g == 0/== 5'"'"'(g) ^ 5'"'"'d1 | (g == 0/'
mutant pinmux crossbar "a line is left out"             's/if \(next\) line <= line \+ 4.d1/if (next) line <= line + 4'"'"'d1 + {3'"'"'d0, line == 4'"'"'d5}/'
mutant pinmux crossbar "ready in the middle of a word"  's/ready = written & ~busy/ready = written/'
mutant pinmux pinmux_out "written with the gate open"   's/shut  = ~gate & ~live/shut  = 1'"'"'b1/'
mutant pinmux pinmux_out "live with the gate"           's/levels <= live \? /levels <= gate ? /'
mutant pinmux pinmux_out "keeps from power-up"          's/opened <= live \| \(opened & ~taken\)/opened <= 1'"'"'b1/'
mutant pinmux pinmux_in "an input with the gate open"   's/shut\(~gate\)/shut(1'"'"'b1)/'
mutant watchdog watchdog "armed over an e-stop"         's/ & ~estop_latched & ~pins/ \& ~pins/'
mutant watchdog watchdog "a system reset hides a bite"  's/\(bitten \| bite\) \? BITE : rst \? SYSTEM_RESET/rst ? SYSTEM_RESET : (bitten | bite) ? BITE/'
mutant led led "double is triple"                       's/3.d4: lit <= .*/3'"'"'d4: lit <= ~(slot[4] \& slot[3]) \& ~slot[2];/'
mutant spi spi "SCK while CS is high"                   's/moves   = busy & ~cs_n/moves   = busy/'
mutant spi spi "one clock too many"                     's/left  <= length - 5.d1/left  <= length/'
mutant spi spi "MISO too early"                         's/moves & \(phase == 2.d2\)\) bit_in/moves \& (phase == 2'"'"'d1)) bit_in/'
mutant spi spi "CS rises in mid-transfer"               's/else cs_n <= ~\(select \| busy\)/else cs_n <= ~select/'
mutant spi spi "CS does not rest"                       's/rested  = cs_n & \(phase == 2.d3\)/rested  = cs_n/'
mutant rgmii rgmii_rx "half a byte more is a byte"      's/odd \| sfd\)/odd | sfd | ~ctl_rise)/'
mutant rgmii rgmii_rx "the SFD aligns nothing"          's/done    <= whole/done    <= dv \& (~slow | odd)/'
mutant rgmii rgmii_rx "RX_ER overlooked"                's/\^ \{8\{bad\}\}/^ 8'"'"'d0/'
mutant rgmii rgmii_rx "RX_ER outlives its frame"        's/\(bad & ~gone\)/bad/'
mutant rgmii rgmii_rx "the link's word is not needed"   's/lo_was\[0\] & ~&lo_was/~\&lo_was/'
mutant rgmii rgmii_rx "never slow"                      's/slow <= ~lo_was\[2\]/slow <= 1'"'"'b0/'
mutant rgmii rgmii_tx "the speed changes in mid-byte"   's/if \(~sending\) halves/halves/'
mutant rgmii rgmii_tx "a gap too short below 1000"      's/halves \? 6.d40/halves ? 6'"'"'d52/'
mutant rgmii rgmii_tx "a nibble on one edge only"       's/\(halves & ~second\) \? data\[3:0\]/1'"'"'b0 ? data[3:0]/'
mutant rgmii rgmii_link "a word without a clock"        's/if \(silence\[8\]\) status <= 4.d0;/if (1'"'"'b0) status <= 4'"'"'d0;/'
mutant rgmii rgmii_link "every other beat"              's/changed = beat_now != beat_was/changed = beat_now \& ~beat_was/'
mutant fast_path fast_path "a wrong FCS is executed"    's/whole & ~bad & mine/whole \& mine/'
mutant fast_path fast_path "a wrong IP sum is executed" 's/ & ~ip_wrong & / \& /'
mutant fast_path fast_path "a wrong UDP sum is executed" 's/complete & \(right \| unsummed\)/complete/'
mutant fast_path fast_path "a frame too short is executed" 's/ & turns & ends;/;/'
mutant fast_path fast_path "a frame a byte too short is executed" 's/last & whole & ~bad/last \& ~bad/'
mutant fast_path fast_path "a frame too long is executed" 's/ & ~\(~head & turns & ends\);/;/'
mutant fast_path fast_path "executed behind another gate" 's/ & \(gate_now == gate_as\)//'
mutant fast_path fast_path "a pass for the frame that was coming" 's/mine <= mine & out;/mine <= mine;/;s/mine <= out & ~waiting/mine <= ~waiting/'
mutant fast_path fast_path "the sequence is not compared" 's/wire free_word = /wire free_word = (at == 5'"'"'d16) | /'
mutant fast_path fast_path "a pass is used twice"       's/\(out & ~revoke & ~take\)/(out \& ~revoke)/'
mutant fast_path fast_path "a revocation in mid-frame is forgotten" 's/\(out & ~revoke & ~take\)/(out \& (~revoke | mine) \& ~take)/'
mutant fast_path fast_path "a fragment is executed"     's/ \| fragment\)\) \| unknown/)) | unknown/'
mutant fast_path fast_path "the bus is held between words" 's/assign hold    = stages/assign hold    = (mine \& alike \& ~head)/'
mutant fast_path fast_path "the answer lies a word further on" 's/put_at <= index;/put_at <= index + 7'"'"'d1;/'
mutant fast_path rx_admission "the lower half is not compared" 's/like_low  = .*/like_low  = 1'"'"'b1;/'
mutant cores pads "one flip-flop"                       's/seen <= meta/seen <= levels/'
mutant cores pads "two pins change places"              's/meta <= levels/meta <= {levels[PINS-1:2], levels[0], levels[1]}/'
mutant cores pace "clocks are counted, not beats"       's/if \(changed\) count/if (1'"'"'b1) count/'
mutant cores pace "the beat of the catching clock, too" 's/caught <= count;/caught <= count + {31'"'"'d0, changed};/'
mutant safety watchdog "a repeat feeds"                 's/\(token_we & \(token != last_token\)\)/token_we/'
mutant watchdog watchdog "a command does not feed"      's/ \| feed;/ | (feed \& 1'"'"'b0);/'
mutant safety watchdog "a token clears a bite"          's/\(bitten & ~cleared\)/(bitten \& ~cleared \& ~token_we)/'
mutant safety watchdog "the grace never ends"           's/all_stopped \| done/all_stopped/'
mutant safety watchdog "a bite one late"                's/done  = less\[32\]/done  = remaining == 32'"'"'hFFFFFFFF/'
mutant safety extreset "the pin is seen late"           's/assign active = sync;/logic [3:0] slow = 4'"'"'hf; always_ff @(posedge clk) slow <= {slow[2:0], sync}; assign active = slow[3];/'
mutant safety gpio "outputs ignore the gate"            's/\(gate & live\) \? driven : safe/live ? driven : safe/'
exit $survived
