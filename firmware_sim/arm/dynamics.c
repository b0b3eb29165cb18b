/* Dynamics of the pneumatic arm: three coupled axes, integrated over an interval of constant commands.
 *
 * This file has the equations of motion and their time step. Commands with their delays, events and sensors are in
 * arm.py, events.py and pins.py; the checks of the parameters are in arm_file.py. native.py mirrors the structs field
 * for field.
 *
 * Each axis is a rodless double-acting cylinder with its own coordinate x in metres: 0 at mid-stroke, increasing as
 * chamber 1 fills. The rotation's cylinder turns the arm by theta = x / pulley radius. Pressures are absolute.
 *
 * Sources
 * - Rigid body: Lagrange's equations, written out in parameters.py.
 * - Orifices: ISO 6358-1, linearised where the pressures are nearly equal.
 * - Chambers: first law of thermodynamics for an open volume with heat through its wall, as in Richer and Hurmuzlu,
 *   J. Dyn. Sys. Meas. Control 122 (2000).
 * - Friction: LuGre, Canudas de Wit, Olsson, Astrom and Lischinsky, IEEE Trans. Autom. Control 40 (1995), with a
 *   rational Stribeck curve.
 * - End stops: Hunt and Crossley, J. Appl. Mech. 42 (1975). The force is continuous at contact.
 *
 * Time step: leapfrog. The pressures are half a step behind spool, positions and velocities, so that each group is
 * stepped with the midpoint values of the other. Pressures take an implicit step, linearised at its start. The body
 * takes drift, kick and drift; the kick is the midpoint rule with implicit friction.
 *
 * Only + - * / and sqrt are used, which IEEE 754 rounds in exactly one way. So a run gives the same bytes on every
 * machine. Never compile this file with -ffast-math or without -ffp-contract=off.
 */

#include <math.h>

enum { VERTICAL, HORIZONTAL, ROTATION, AXES };
enum { CHAMBERS = 2 };

struct axis_parameters {
    double area_m2, half_stroke_m, dead_volume_m3, heat_w_k;
    double conductance_m3_s_pa, critical_ratio, overlap, clearance, spool_rad_s, spool_damping;
    double coulomb_n, static_n, stribeck_m_s, bristle_n_m, bristle_n_s_m, viscous_n_s_m, per_moment_1_n_m;
    double spring_n_m, spring_centre_n, stop_n_m, stop_s_m;
};

struct arm_parameters {
    struct axis_parameters axis[AXES];
    double vertical_kg, horizontal_kg, base_kg_m2, reach_m, tip_m, pulley_m;
    double supply_m3, regulator_kg_s_pa, regulator_max_kg_s, regulator_relief_kg_s, atmosphere_pa;
};

struct axis_conditions {
    double spool_command; /* -1 to 1, after delay and play */
    double spool_free;    /* 1, or 0 while the spool is stuck */
    double friction_factor;
    double leak_m3_s_pa[CHAMBERS];
};

struct arm_conditions {
    struct axis_conditions axis[AXES];
    double payload_kg, regulator_pa, air_k;
};

struct axis_state {
    double spool, spool_rate_1_s;
    double position_m, velocity_m_s, bristle_m;
    double pressure_pa[CHAMBERS], air_kg[CHAMBERS];
};

struct arm_state {
    struct axis_state axis[AXES];
    double supply_pa;
    double supplied_kg, exhausted_kg; /* masses of air since the start */
};

static const double HEAT_RATIO = 1.4, GAS_J_KG_K = 287.05, GRAVITY_M_S2 = 9.80665;
static const double REFERENCE_KG_M3 = 1.185, REFERENCE_K = 293.15; /* ISO 6358 */
static const double LINEAR_FROM = 0.99; /* pressure ratio above which an orifice is linear */
static const double MAX_PRESSURE_PA = 1e7, MAX_SPEED_M_S = 1e3; /* beyond them the simulation has diverged */
static const double PIECES_PER_TIME_CONSTANT = 2.0;
enum { MAX_PIECES = 10000 };

/* ---- air ---- */

struct flow {
    double kg_s, per_upstream, per_downstream; /* mass flow and its derivatives in kg/(s Pa) */
};

/* Density in kg/m3. ISO 6358: choked mass flow = conductance x upstream pressure x this density. */
static double sonic_density(double air_k) { return REFERENCE_KG_M3 * sqrt(REFERENCE_K / air_k); }

/* Flow from the higher to the lower pressure. `choked` is conductance x sonic density, in kg/(s Pa). */
static struct flow falling_flow(double choked, double critical, double high_pa, double low_pa)
{
    const double ratio = low_pa / high_pa;
    if (ratio <= critical)
        return (struct flow){choked * high_pa, choked, 0.0};
    const double per_width = 1.0 / (1.0 - critical);
    const double excess = ((ratio < LINEAR_FROM ? ratio : LINEAR_FROM) - critical) * per_width;
    const double shape = sqrt(1.0 - excess * excess);
    if (ratio < LINEAR_FROM) {
        const double slope = -excess * per_width / shape;
        return (struct flow){choked * high_pa * shape, choked * (shape - ratio * slope), choked * slope};
    }
    const double linear = choked * shape / (1.0 - LINEAR_FROM);
    return (struct flow){linear * (high_pa - low_pa), linear, -linear};
}

/* Flow in either direction, positive from `up` to `down`. The densities are sonic_density() of the air on each side. */
static struct flow orifice(double conductance, double critical, double up_pa, double up_density, double down_pa,
                           double down_density)
{
    if (up_pa >= down_pa)
        return falling_flow(conductance * up_density, critical, up_pa, down_pa);
    const struct flow back = falling_flow(conductance * down_density, critical, down_pa, up_pa);
    return (struct flow){-back.kg_s, -back.per_downstream, -back.per_upstream};
}

/* Conductance of one edge of the spool. The clearance rounds the curve where the edge opens. */
static double opening(const struct axis_parameters *p, double spool)
{
    const double lift = spool - p->overlap;
    return 0.5 * p->conductance_m3_s_pa * (lift + sqrt(lift * lift + p->clearance * p->clearance));
}

/* Step the spool by the midpoint rule; it stops at full travel. */
static void step_spool(const struct axis_parameters *p, const struct axis_conditions *c, struct axis_state *s, double dt)
{
    const double half = 0.5 * dt, turn = half * p->spool_rad_s;
    const double pull = turn * p->spool_rad_s * (c->spool_command - s->spool);
    const double rate = c->spool_free * (s->spool_rate_1_s + pull) / (1.0 + turn * (turn + 2.0 * p->spool_damping));
    s->spool += dt * rate;
    s->spool_rate_1_s = 2.0 * rate - c->spool_free * s->spool_rate_1_s;
    if (fabs(s->spool) > 1.0) {
        s->spool = s->spool > 0.0 ? 1.0 : -1.0;
        s->spool_rate_1_s = 0.0;
    }
}

/* Weight of a quantity's own rise in the rate of an implicit step that is `stiffness` time constants long.
 *
 * The weight is 1/2 (trapezoidal rule) for a short step and 1 (implicit Euler) for a long one. A deviation then decays
 * by the factor 1/(1 + z + z^2/2), z = stiffness: second order and L-stable, like the step of the bristle. */
static double share_of_rise(double stiffness) { return stiffness > 0.0 ? (1.0 + stiffness) / (2.0 + stiffness) : 0.5; }

/* One chamber in the implicit step of all pressures. Its pressure rises by rise + rise_per_supply x (mean rise of the
 * supply during the step). `share` is share_of_rise() of the chamber. */
struct chamber {
    struct flow in, out;
    double rise, rise_per_supply, share;
};

/* Quantities that are common to all chambers in a step. */
struct surroundings {
    double supply_pa, atmosphere_pa, air_k, density;
};

/* A chamber at the start of a step: volume in m3, its rate in m3/s, conductances to the supply and the atmosphere. */
struct vessel {
    double volume, growth, inlet, outlet;
};

static struct chamber solve_chamber(const struct surroundings *around, const struct vessel *vessel, double pressure,
                                    double air_kg, double wall_w_k, double critical, double dt)
{
    const double growth = vessel->growth, volume = vessel->volume + 0.5 * dt * growth;
    const double k_per_pa = vessel->volume / (air_kg * GAS_J_KG_K), air_k = k_per_pa * pressure;
    const double density = sonic_density(air_k);
    struct chamber chamber;
    chamber.in = orifice(vessel->inlet, critical, around->supply_pa, around->density, pressure, density);
    chamber.out = orifice(vessel->outlet, critical, pressure, density, around->atmosphere_pa, around->density);
    const double in_heat = HEAT_RATIO * GAS_J_KG_K * (chamber.in.kg_s >= 0.0 ? around->air_k : air_k);
    const double out_heat = HEAT_RATIO * GAS_J_KG_K * (chamber.out.kg_s >= 0.0 ? air_k : around->air_k);
    const double wall = (HEAT_RATIO - 1.0) * wall_w_k;
    const double power = in_heat * chamber.in.kg_s - out_heat * chamber.out.kg_s + wall * (around->air_k - air_k) -
                         HEAT_RATIO * pressure * growth;
    const double decay = out_heat * chamber.out.per_upstream - in_heat * chamber.in.per_downstream + wall * k_per_pa +
                         HEAT_RATIO * growth;
    chamber.share = share_of_rise(dt * decay / volume);
    const double per_power = dt / (volume + chamber.share * dt * decay);
    chamber.rise = power * per_power;
    chamber.rise_per_supply = in_heat * chamber.in.per_upstream * per_power;
    return chamber;
}

/* Step all chambers and the supply together. What leaves one volume enters another, so air is conserved to rounding. */
static void step_pressures(const struct arm_parameters *arm, const struct arm_conditions *c, struct arm_state *s,
                           const struct vessel vessels[AXES][CHAMBERS], double dt)
{
    const struct surroundings around = {s->supply_pa, arm->atmosphere_pa, c->air_k, sonic_density(c->air_k)};
    const double capacity = arm->supply_m3 / (GAS_J_KG_K * c->air_k * dt);
    double drawn = 0.0, drawn_per_pa = 0.0, drawn_at_once_per_pa = 0.0;
    struct chamber chambers[AXES][CHAMBERS];
    for (int a = 0; a < AXES; a++)
        for (int i = 0; i < CHAMBERS; i++) {
            const struct axis_parameters *p = &arm->axis[a];
            const struct axis_state *x = &s->axis[a];
            const struct chamber chamber = solve_chamber(&around, &vessels[a][i], x->pressure_pa[i], x->air_kg[i],
                                                         p->heat_w_k, p->critical_ratio, dt);
            const double per_rise = chamber.share * chamber.in.per_downstream;
            drawn += chamber.in.kg_s + per_rise * chamber.rise;
            drawn_per_pa += chamber.in.per_upstream + per_rise * chamber.rise_per_supply;
            drawn_at_once_per_pa += chamber.in.per_upstream;
            chambers[a][i] = chamber;
        }
    const double regulator_per_pa = arm->regulator_kg_s_pa;
    const double share = share_of_rise((regulator_per_pa + drawn_at_once_per_pa) / capacity);
    const double inertia = capacity / share + drawn_per_pa;
    const double wanted = regulator_per_pa * (c->regulator_pa - s->supply_pa);
    double mean_rise = (wanted - drawn) / (inertia + regulator_per_pa);
    double regulator = wanted - regulator_per_pa * mean_rise;
    if (regulator > arm->regulator_max_kg_s || regulator < -arm->regulator_relief_kg_s) {
        regulator = regulator > 0.0 ? arm->regulator_max_kg_s : -arm->regulator_relief_kg_s;
        mean_rise = (regulator - drawn) / inertia;
    }
    s->supply_pa += mean_rise / share;
    s->supplied_kg += dt * regulator;
    for (int a = 0; a < AXES; a++)
        for (int i = 0; i < CHAMBERS; i++) {
            const struct chamber *chamber = &chambers[a][i];
            const double rise = chamber->rise + chamber->rise_per_supply * mean_rise;
            const double seen = chamber->share * rise;
            const double in_kg = dt * (chamber->in.kg_s + chamber->in.per_upstream * mean_rise +
                                       chamber->in.per_downstream * seen);
            const double out_kg = dt * (chamber->out.kg_s + chamber->out.per_upstream * seen);
            s->axis[a].pressure_pa[i] += rise;
            s->axis[a].air_kg[i] += in_kg - out_kg;
            s->exhausted_kg += out_kg;
        }
}

/* Step the pressures from half a step before positions and velocities to half a step after them.
 *
 * If an orifice would empty its chamber within about one step, the step is divided into pieces, because the
 * linearisation does not hold for so long. */
static void step_air(const struct arm_parameters *arm, const struct arm_conditions *c, struct arm_state *s, double dt)
{
    const double flow_per_m3 = GAS_J_KG_K * c->air_k * sonic_density(c->air_k);
    struct vessel vessels[AXES][CHAMBERS];
    double fastest_1_s = 0.0, inlets = 0.0;
    for (int a = 0; a < AXES; a++) {
        const struct axis_parameters *p = &arm->axis[a];
        const struct axis_state *x = &s->axis[a];
        const double edges[CHAMBERS] = {opening(p, x->spool), opening(p, -x->spool)};
        for (int i = 0; i < CHAMBERS; i++) {
            const double side = i == 0 ? p->area_m2 : -p->area_m2, growth = side * x->velocity_m_s;
            const double volume = p->dead_volume_m3 + p->area_m2 * p->half_stroke_m + side * x->position_m;
            const double outlet = edges[1 - i] + c->axis[a].leak_m3_s_pa[i];
            const double rate_1_s = HEAT_RATIO * flow_per_m3 * (edges[i] + outlet) / volume;
            vessels[a][i] = (struct vessel){volume - 0.5 * dt * growth, growth, edges[i], outlet};
            inlets += edges[i];
            fastest_1_s = rate_1_s > fastest_1_s ? rate_1_s : fastest_1_s;
        }
    }
    const double supply_1_s = flow_per_m3 * inlets / arm->supply_m3;
    const double pieces = PIECES_PER_TIME_CONSTANT * dt * (supply_1_s > fastest_1_s ? supply_1_s : fastest_1_s);
    const int count = pieces < MAX_PIECES ? 1 + (int)pieces : MAX_PIECES;
    const double piece_s = dt / count;
    for (int n = 0; n < count; n++) {
        step_pressures(arm, c, s, vessels, piece_s);
        for (int a = 0; a < AXES; a++)
            for (int i = 0; i < CHAMBERS; i++)
                vessels[a][i].volume += piece_s * vessels[a][i].growth;
    }
}

/* ---- body ---- */

/* Step the velocity of one axis under `force`, friction and end stops. `load` scales dry friction.
 *
 * The bristle's equation is z' = v - wear z. Its step uses the second-order, L-stable Pade approximation of the
 * exponential. The second pass evaluates wear at the mean velocity of the step; with the velocity at the start, dry
 * friction would lag behind each acceleration. */
static void kick_axis(const struct axis_parameters *p, struct axis_state *s, double mass, double force,
                      double friction_factor, double load, double dt)
{
    const double inertia = 2.0 * mass / dt;
    const double side = s->position_m > 0.0 ? 1.0 : -1.0;
    const double depth = side * s->position_m - p->half_stroke_m;
    double mean = s->velocity_m_s, bristle = s->bristle_m;
    for (int pass = 0; pass < 2; pass++) {
        const double stribeck = mean / p->stribeck_m_s;
        const double dry = p->coulomb_n + (p->static_n - p->coulomb_n) / (1.0 + stribeck * stribeck);
        const double wear = p->bristle_n_m * fabs(mean) / dry, worn = dt * wear;
        const double kept = 1.0 / (1.0 + worn + 0.5 * worn * worn);
        const double fed = dt * (1.0 + 0.5 * worn) * kept;
        const double hold = friction_factor * (load * p->bristle_n_m - p->bristle_n_s_m * wear);
        const double resistance = inertia + 0.5 * hold * fed + friction_factor * (p->bristle_n_s_m + p->viscous_n_s_m);
        const double push = inertia * s->velocity_m_s + force - 0.5 * hold * (1.0 + kept) * s->bristle_m;
        mean = push / resistance;
        if (depth > 0.0) {
            const double elastic = p->stop_n_m * depth;
            const double stopped = (push - side * elastic) / (resistance + elastic * p->stop_s_m);
            if (1.0 + p->stop_s_m * side * stopped > 0.0) /* a stop pushes, it never pulls */
                mean = stopped;
        }
        bristle = kept * s->bristle_m + fed * mean;
    }
    s->bristle_m = bristle;
    s->velocity_m_s = 2.0 * mean - s->velocity_m_s;
}

/* Step the velocities of all axes: eq. (1), each row in the coordinate of the axis' own cylinder. */
static void kick_body(const struct arm_parameters *arm, const struct arm_conditions *c, struct arm_state *s, double dt)
{
    const double link = arm->horizontal_kg, payload = c->payload_kg, pulley = arm->pulley_m;
    const double reach = arm->reach_m + s->axis[HORIZONTAL].position_m, tip = reach + arm->tip_m;
    const double moment_kg_m = link * reach + payload * tip;
    const double inertia_kg_m2 = arm->base_kg_m2 + link * reach * reach + payload * tip * tip;
    const double turning_rad_s = s->axis[ROTATION].velocity_m_s / pulley;
    const double mass[AXES] = {arm->vertical_kg + link + payload, link + payload, inertia_kg_m2 / (pulley * pulley)};
    const double inertial_force[AXES] = {
        -mass[VERTICAL] * GRAVITY_M_S2,
        moment_kg_m * turning_rad_s * turning_rad_s,
        -2.0 * moment_kg_m * s->axis[HORIZONTAL].velocity_m_s * turning_rad_s / pulley,
    };
    const double tilt_n_m = GRAVITY_M_S2 * (moment_kg_m - link * arm->reach_m);
    for (int a = 0; a < AXES; a++) {
        const struct axis_parameters *p = &arm->axis[a];
        struct axis_state *x = &s->axis[a];
        const double force = (x->pressure_pa[0] - x->pressure_pa[1]) * p->area_m2 + p->spring_centre_n -
                             p->spring_n_m * x->position_m + inertial_force[a];
        kick_axis(p, x, mass[a], force, c->axis[a].friction_factor, 1.0 + p->per_moment_1_n_m * tilt_n_m, dt);
    }
}

/* ---- interface for native.py ---- */

/* Return 0 if the state is possible, 1 + axis if the state of that axis is not, 1 + AXES if the supply is not.
 * A NaN is never possible. */
static int fault_of(const struct arm_parameters *arm, const struct arm_state *s)
{
    for (int a = 0; a < AXES; a++) {
        const struct axis_state *x = &s->axis[a];
        const int pressures = x->pressure_pa[0] > 0.0 && x->pressure_pa[0] < MAX_PRESSURE_PA &&
                              x->pressure_pa[1] > 0.0 && x->pressure_pa[1] < MAX_PRESSURE_PA &&
                              x->air_kg[0] > 0.0 && x->air_kg[1] > 0.0;
        const double room = arm->axis[a].half_stroke_m + arm->axis[a].dead_volume_m3 / arm->axis[a].area_m2;
        if (!(pressures && fabs(x->position_m) < room && fabs(x->velocity_m_s) < MAX_SPEED_M_S && fabs(x->spool) < 2.0))
            return 1 + a;
    }
    return s->supply_pa > 0.0 && s->supply_pa < MAX_PRESSURE_PA ? 0 : 1 + AXES;
}

/* Integrate over duration_s in `steps` equal steps. Stops at the first state that is not possible, and returns its
 * fault_of(); 0 means success. */
int arm_advance(const struct arm_parameters *arm, const struct arm_conditions *c, struct arm_state *s, double duration_s,
                int steps)
{
    const double dt = duration_s / steps;
    int fault = fault_of(arm, s);
    for (int n = 0; n < steps && fault == 0; n++) {
        step_air(arm, c, s, dt);
        for (int a = 0; a < AXES; a++) {
            step_spool(&arm->axis[a], &c->axis[a], &s->axis[a], dt);
            s->axis[a].position_m += 0.5 * dt * s->axis[a].velocity_m_s;
        }
        kick_body(arm, c, s, dt);
        for (int a = 0; a < AXES; a++)
            s->axis[a].position_m += 0.5 * dt * s->axis[a].velocity_m_s;
        fault = fault_of(arm, s);
    }
    return fault;
}

/* Sizes of the three structs. native.py compares them to detect a library that was built from other sources. */
void arm_layout(int sizes[3])
{
    sizes[0] = (int)sizeof(struct arm_parameters);
    sizes[1] = (int)sizeof(struct arm_conditions);
    sizes[2] = (int)sizeof(struct arm_state);
}
