#!/usr/bin/env bash
# Breaks the cores one way at a time and expects their bench to notice. By hand, minutes: a bench that cannot fail is worth
# nothing, but it need not prove that every day.
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
    if said=$(RTL=$scratch/rtl OUT=$scratch/out timeout 300 "$here/run.sh" "$1" 1 2>&1); then
        echo "SURVIVED $1: $3"
        survived=1
    elif echo "$said" | grep -q "does not build"; then
        echo "BROKEN   $1: $3 (does not build)"
        survived=1
    else
        echo "caught   $1: $3 -- $(echo "$said" | tail -1 | cut -c1-110)"
    fi
}

mutant stepgen stepgen "steplen one short"              's/step_left <= steplen;/step_left <= steplen - 16'"'"'d1;/'
mutant stepgen stepgen "stepspace forgotten"            's/else if \(fall\) step_left <= stepspace;/else if (fall) step_left <= stepspace \& 16'"'"'d0;/'
mutant stepgen stepgen "dirsetup not waited for"        's/ & ~\(setup & ~dir_done\);/;/'
mutant stepgen stepgen "dirhold not waited for"         's/\(setup \| dir_done\) & \(negative/(negative/'
mutant stepgen stepgen "a pulse in the old direction"   's/step_done & \(reverse == negative\)/step_done/'
mutant stepgen stepgen "a due pulse is lost"            's/if \(gate & \(~due \| ready\)\) fraction/if (gate) fraction/'
mutant stepgen stepgen "counts without a pulse"         's/if \(emit\) pulses/if (gate \& due) pulses/'
mutant stepgen stepgen "a pulse at gate close"          's/emit = gate & due & ready/emit = due \& ready/'
mutant stepgen stepgen "the ramp passes its target"     's/arrived = jump \| \(up \^ below\)/arrived = jump/'
mutant stepgen stepgen "the ramp learns nothing"        's/if \(fresh\) up <= below;/if (fresh) up <= 1'"'"'b1;/'
mutant stepgen stepgen "counters narrower than their registers" 's/dir_left <= dirsetup;/dir_left <= dirsetup \& 24'"'"'h00ffff;/'
mutant encoder encoder "direction reversed"             's/down    = a_level \^ b_was/down    = ~(a_level ^ b_was)/'
mutant encoder encoder "filter one short"               's/held >= filter/held + 1 >= filter/'
mutant encoder encoder "latches every index"            's/ & ~latched\) begin/) begin/'
mutant pwm pwm "width taken in mid-period"              's/count < this_width/count < (commit ? next_width : this_width)/'
mutant pwm pwm "period one long"                        's/last  = after >= /last  = after > /'
mutant timebase timebase "timed commit one late"        's/due  <= next >= commit_at/due  <= now >= commit_at/'
mutant safety watchdog "a repeat feeds"                 's/fed  = token_we & \(token != last_token\)/fed  = token_we/'
mutant safety watchdog "a token clears a bite"          's/if \(token_we\) last_token <= token;/if (token_we) begin last_token <= token; bitten <= 1'"'"'b0; end/'
mutant safety watchdog "the grace never ends"           's/all_stopped \| \(patience == 32.d0\)/all_stopped/'
mutant safety watchdog "a bite one late"                's/remaining == 32.d0/remaining == 32'"'"'hFFFFFFFF/'
mutant safety extreset "the pin is seen late"           's/assign active = sync;/logic [3:0] slow = 4'"'"'hf; always_ff @(posedge clk) slow <= {slow[2:0], sync}; assign active = slow[3];/'
mutant safety gpio "outputs ignore the gate"            's/\(gate & live\) \? held : safe/live ? held : safe/'
exit $survived
