/* Clamped square plates, all steps of a plate in one go; problem.py states the work.
 *
 * Compiled for one grid and one precision: -DNODES=27 -DREAL=float. Three ways:
 *   a batch of plates          a plate at a time, its state in near cache, plates dealt out to threads
 *   a large batch              LANES plates side by side, the plate index innermost: no load is unaligned
 *   fewer plates than threads  each plate cut into slabs of rows, a slab a thread, one barrier a step
 *
 * The biharmonic is the Laplacian applied twice. On a clamped edge u = 0 and the ghost equals the first node
 * inside, so there the Laplacian is twice that node; the second Laplacian needs to know no more of the edge.
 */
#include <pthread.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

typedef REAL real;

enum {
    LANES = 64 / sizeof(real),                    /* in one 64-byte vector */
    STRIDE = (NODES + LANES - 1) / LANES * LANES, /* a row, padded to whole vectors; node i is column i */
    PLANE = NODES * STRIDE,
    ROWS = NODES - 2,                             /* rows that move: 1 .. NODES - 2 */
    BAND = ROWS <= 32 ? ROWS : 8,                 /* rows from one Laplacian to the next, to stay in cache */
    LINE = NODES * LANES,                         /* a row of LANES plates side by side */
    GROUP = NODES * LINE,
    MOST_THREADS = 256
};

static const real STIFFNESS = 0.24 * 0.24, DECAY = 0.98;

#define INLINE static inline __attribute__((always_inline))

struct work {
    int plates, groups, steps, first, threads;
    const real *cosine, *sine, *in_phase, *quadrature, *weights;
    double *energy;
    real *u[2], *q, *squares; /* shared by all threads in slabs(), else unused */
    atomic_int taken, arrived, round;
};

struct member {
    struct work *work;
    int thread;
};

static real *zeros(size_t count)
{
    size_t bytes = (count * sizeof(real) + 63) / 64 * 64;
    real *memory = aligned_alloc(64, bytes);
    if (!memory)
        abort();
    memset(memory, 0, bytes);
    return memory;
}

static void wait_for_all(struct work *work)
{
    int round = atomic_load(&work->round);
    if (atomic_fetch_add(&work->arrived, 1) == work->threads - 1) {
        atomic_store(&work->arrived, 0);
        atomic_store(&work->round, round + 1);
        return;
    }
    for (int turn = 0; atomic_load(&work->round) == round; turn++)
        if (turn > 500) /* another program may hold the core that the last thread needs */
            sched_yield();
#ifdef __x86_64__
        else
            __builtin_ia32_pause();
#endif
}

/* ---- one plate: rows of STRIDE columns ---- */

struct tables {
    real inside[STRIDE] __attribute__((aligned(64)));    /* 1 inside, 2 at the two edges, 0 in the padding */
    real stiffness[STRIDE] __attribute__((aligned(64))); /* 0 outside the interior */
};

static void fill_tables(struct tables *tables)
{
    for (int i = 0; i < STRIDE; i++) {
        tables->inside[i] = i == 0 || i == NODES - 1 ? 2 : i < NODES ? 1 : 0;
        tables->stiffness[i] = i > 0 && i < NODES - 1 ? STIFFNESS : 0;
    }
}

INLINE void laplacian_row(const real *restrict u, int row, const real *restrict inside, real *restrict out)
{
    const real *restrict at = u + (size_t)row * STRIDE;
    if (row == 0 || row == NODES - 1) {
        const real *restrict next = row == 0 ? at + STRIDE : at - STRIDE;
        for (int i = 0; i < STRIDE; i++)
            out[i] = 2 * next[i];
    } else
        for (int i = 0; i < STRIDE; i++)
            out[i] = inside[i] * ((at[i - 1] + at[i + 1]) + (at[i - STRIDE] + at[i + STRIDE]) - 4 * at[i]);
}

/* One step of rows start .. stop - 1. u_next may be u: a row is written only after its last reading. */
INLINE void step_rows(int start, int stop, int measured, real cosine, real sine,
                      const struct tables *restrict tables, const real *u, real *u_next, real *restrict q,
                      real *restrict squares, const real *restrict in_phase, const real *restrict quadrature,
                      real *restrict laplacian)
{
    for (int from = start; from < stop; from += BAND) {
        int to = from + BAND < stop ? from + BAND : stop; /* laplacian is to hold rows from - 1 .. to */
        if (from == start) {
            laplacian_row(u, from - 1, tables->inside, laplacian);
            laplacian_row(u, from, tables->inside, laplacian + STRIDE);
        } else
            memcpy(laplacian, laplacian + BAND * STRIDE, 2 * STRIDE * sizeof(real));
        for (int row = from + 1; row <= to; row++)
            laplacian_row(u, row, tables->inside, laplacian + (row - from + 1) * STRIDE);
        for (int row = from; row < to; row++) {
            const real *restrict l = laplacian + (row - from + 1) * STRIDE;
#pragma GCC ivdep
            for (int i = 0; i < STRIDE; i++) {
                size_t k = (size_t)row * STRIDE + i;
                real biharmonic = (l[i - 1] + l[i + 1]) + (l[i - STRIDE] + l[i + STRIDE]) - 4 * l[i];
                real load = cosine * in_phase[k] + sine * quadrature[k];
                real x = DECAY * q[k] - tables->stiffness[i] * biharmonic + load;
                q[k] = x;
                u_next[k] = u[k] + x;
                if (measured)
                    squares[k] += x * x;
            }
        }
    }
}

static double energy_of_rows(const real *restrict squares, int start, int stop, const real *restrict weights)
{
    double sum = 0;
    for (int row = start; row < stop; row++)
        for (int i = 1; i < NODES - 1; i++)
            sum += (double)weights[row * NODES + i] * squares[(size_t)row * STRIDE + i];
    return sum;
}

static void plates(struct work *work)
{
    struct tables tables;
    fill_tables(&tables);
    real *u = zeros(3 * (size_t)PLANE + (BAND + 2) * STRIDE);
    real *q = u + PLANE, *squares = q + PLANE, *laplacian = squares + PLANE;
    for (int plate; (plate = atomic_fetch_add(&work->taken, 1)) < work->plates;) {
        const real *in_phase = work->in_phase + (size_t)plate * PLANE;
        const real *quadrature = work->quadrature + (size_t)plate * PLANE;
        memset(u, 0, 3 * (size_t)PLANE * sizeof(real));
        for (int m = 0; m < work->steps; m++) {
            const real c = work->cosine[m], s = work->sine[m];
            if (m < work->first)
                step_rows(1, NODES - 1, 0, c, s, &tables, u, u, q, squares, in_phase, quadrature, laplacian);
            else
                step_rows(1, NODES - 1, 1, c, s, &tables, u, u, q, squares, in_phase, quadrature, laplacian);
        }
        for (int region = 0; region < 2; region++)
            work->energy[2 * plate + region] =
                energy_of_rows(squares, 1, NODES - 1, work->weights + region * NODES * NODES);
    }
    free(u);
}

/* ---- each plate over all threads: with u held twice, one barrier a step is enough ---- */

static void slabs(struct work *work, int thread)
{
    struct tables tables;
    fill_tables(&tables);
    const int start = 1 + ROWS * thread / work->threads, stop = 1 + ROWS * (thread + 1) / work->threads;
    const size_t begin = (size_t)start * STRIDE, bytes = (size_t)(stop - start) * STRIDE * sizeof(real);
    real *q = work->q, *squares = work->squares, *lap = zeros((BAND + 2) * STRIDE);
    for (int plate = 0; plate < work->plates; plate++) {
        const real *in_phase = work->in_phase + (size_t)plate * PLANE;
        const real *quadrature = work->quadrature + (size_t)plate * PLANE;
        memset(work->u[0] + begin, 0, bytes);
        memset(q + begin, 0, bytes);
        memset(squares + begin, 0, bytes);
        wait_for_all(work);
        for (int m = 0; m < work->steps; m++) {
            const real c = work->cosine[m], s = work->sine[m], *u = work->u[m % 2];
            real *next = work->u[(m + 1) % 2];
            if (m < work->first)
                step_rows(start, stop, 0, c, s, &tables, u, next, q, squares, in_phase, quadrature, lap);
            else
                step_rows(start, stop, 1, c, s, &tables, u, next, q, squares, in_phase, quadrature, lap);
            wait_for_all(work);
        }
        for (int region = 0; region < 2; region++) /* c_plate.py adds the threads up */
            work->energy[2 * (thread * work->plates + plate) + region] =
                energy_of_rows(squares, start, stop, work->weights + region * NODES * NODES);
    }
    free(lap);
}

/* ---- LANES plates side by side: a node is LANES numbers ---- */

INLINE void laplacian_line(const real *restrict u, int row, real *restrict out)
{
    const real *restrict at = u + (size_t)row * LINE;
    if (row == 0 || row == NODES - 1) {
        const real *restrict next = row == 0 ? at + LINE : at - LINE;
        for (int i = LANES; i < LINE - LANES; i++)
            out[i] = 2 * next[i];
        return;
    }
    for (int i = LANES; i < LINE - LANES; i++)
        out[i] = (at[i - LANES] + at[i + LANES]) + (at[i - LINE] + at[i + LINE]) - 4 * at[i];
    for (int lane = 0; lane < LANES; lane++) {
        out[lane] = 2 * at[LANES + lane];
        out[LINE - LANES + lane] = 2 * at[LINE - 2 * LANES + lane];
    }
}

INLINE void step_group(int measured, real cosine, real sine, real *restrict u, real *restrict q,
                       real *restrict squares, const real *restrict in_phase,
                       const real *restrict quadrature, real *restrict lines)
{
    real *below = lines, *l = lines + LINE, *above = lines + 2 * LINE; /* Laplacians of three rows */
    laplacian_line(u, 0, below);
    laplacian_line(u, 1, l);
    for (int row = 1; row < NODES - 1; row++) {
        laplacian_line(u, row + 1, above);
#pragma GCC ivdep
        for (int i = LANES; i < LINE - LANES; i++) {
            size_t k = (size_t)row * LINE + i;
            real biharmonic = (l[i - LANES] + l[i + LANES]) + (below[i] + above[i]) - 4 * l[i];
            real x = DECAY * q[k] - STIFFNESS * biharmonic + (cosine * in_phase[k] + sine * quadrature[k]);
            q[k] = x;
            u[k] += x;
            if (measured)
                squares[k] += x * x;
        }
        real *oldest = below;
        below = l;
        l = above;
        above = oldest;
    }
}

static void groups(struct work *work)
{
    real *u = zeros(3 * (size_t)GROUP + 3 * LINE);
    real *q = u + GROUP, *squares = q + GROUP, *lines = squares + GROUP;
    for (int group; (group = atomic_fetch_add(&work->taken, 1)) < work->groups;) {
        const real *in_phase = work->in_phase + (size_t)group * GROUP;
        const real *quadrature = work->quadrature + (size_t)group * GROUP;
        double *energy = work->energy + (size_t)group * 2 * LANES;
        memset(u, 0, 3 * (size_t)GROUP * sizeof(real));
        for (int m = 0; m < work->steps; m++) {
            const real c = work->cosine[m], s = work->sine[m];
            if (m < work->first)
                step_group(0, c, s, u, q, squares, in_phase, quadrature, lines);
            else
                step_group(1, c, s, u, q, squares, in_phase, quadrature, lines);
        }
        for (int region = 0; region < 2; region++)
            for (int node = 0; node < NODES * NODES; node++)
                for (int lane = 0; lane < LANES; lane++)
                    energy[2 * lane + region] +=
                        (double)work->weights[region * NODES * NODES + node] * squares[node * LANES + lane];
    }
    free(u);
}

/* ---- threads ---- */

static void *member_run(void *argument)
{
    struct member *member = argument;
    struct work *work = member->work;
    if (work->groups)
        groups(work);
    else if (work->plates >= work->threads)
        plates(work);
    else
        slabs(work, member->thread);
    return NULL;
}

/* Loads are (groups, NODES, NODES, LANES) where groups > 0, else (plates, NODES, STRIDE), from a 64-byte
 * boundary. energy starts at zero; it is (groups * LANES, 2), or (plates, 2), or (threads, plates, 2) where
 * there are fewer plates than threads. threads <= MOST_THREADS. */
void run(int plate_count, int group_count, int steps, int first, int threads, const real *cosine,
         const real *sine, const real *in_phase, const real *quadrature, const real *weights, double *energy)
{
    struct work work = {.plates = plate_count, .groups = group_count, .steps = steps, .first = first,
                        .threads = threads, .cosine = cosine, .sine = sine, .in_phase = in_phase,
                        .quadrature = quadrature, .weights = weights, .energy = energy};
    struct member members[MOST_THREADS];
    pthread_t started[MOST_THREADS];
    real *shared = NULL;
    if (!group_count && plate_count < threads) {
        shared = zeros(4 * (size_t)PLANE);
        work.u[0] = shared;
        work.u[1] = shared + PLANE;
        work.q = shared + 2 * PLANE;
        work.squares = shared + 3 * PLANE;
    }
    members[0] = (struct member){&work, 0};
    for (int thread = 1; thread < threads; thread++) {
        members[thread] = (struct member){&work, thread};
        if (pthread_create(&started[thread], NULL, member_run, &members[thread]))
            abort(); /* the others would wait for it for ever */
    }
    member_run(&members[0]);
    for (int thread = 1; thread < threads; thread++)
        pthread_join(started[thread], NULL);
    free(shared);
}
