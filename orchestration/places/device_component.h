/* One component of a system: in a namespace of its own, after instance.h of its FMU, whose steps it makes. */

struct Instance {
    Data data;
    StepCache cache;
};

static void parameters_changed(Instance *one) { one->data.parameters_are_stale = one->cache.is_stale = 1; }

/* Initial states and outputs at a time [s], from parameters and inputs. Whether they are refused. */
static int initialise(Instance *one, double time) {
    int broken = 0;
    parameters_changed(one);
    one->data.outputs_are_stale = 1;
    one->data.mode = INITIALIZATION;
    one->data.time = time;
    const Outcome outcome = data_refresh(&one->data, &broken);
    one->data.mode = STEPPING;
    return outcome != DONE;
}

/* From start to start + size [s]. Whether the step is refused. */
static int step(Instance *one, double start, double size) {
    int broken = 0;
    return data_step(&one->data, &one->cache, start, size, one->data.value + FIRST_INPUT, &broken) != DONE;
}

/* Its words and those of `Data`, its internal step; how many Reals take whole numbers alone. */
static void write_sizes(int64_t *sizes) {
    sizes[0] = sizeof(Instance) / 8, sizes[1] = sizeof(Data) / 8, sizes[2] = INTERNAL_STEP, sizes[3] = 0;
    for (int i = 0; i < N_VALUES; i++) sizes[3] += VARIABLES[i].whole;
}
