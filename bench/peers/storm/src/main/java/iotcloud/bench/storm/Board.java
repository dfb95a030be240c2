package iotcloud.bench.storm;

import java.io.IOException;
import java.io.UncheckedIOException;
import java.lang.invoke.MethodHandles;
import java.lang.invoke.VarHandle;
import java.nio.ByteBuffer;
import java.nio.ByteOrder;
import java.nio.channels.FileChannel;
import java.nio.channels.FileChannel.MapMode;
import java.nio.file.Path;
import java.nio.file.StandardOpenOption;
import org.apache.storm.task.TopologyContext;

/** The files of numbers of bench/storm/components.cc. */
final class Board {
    static final int RATE = 0;
    static final int EMITTED = 0;
    static final int RESULTS = 1;
    static final int FAILED = 2;
    private static final int LATENCIES = 8;
    private static final int BUCKETS = 704;
    private static final VarHandle NUMBER = MethodHandles.byteBufferViewVarHandle(long[].class, ByteOrder.LITTLE_ENDIAN);

    private final ByteBuffer numbers;

    private Board(String folder, String name) {
        try (FileChannel file = FileChannel.open(Path.of(folder, name), StandardOpenOption.READ, StandardOpenOption.WRITE,
                StandardOpenOption.CREATE)) {
            numbers = file.map(MapMode.READ_WRITE, 0, Long.BYTES * (LATENCIES + BUCKETS));
        } catch (IOException error) {
            throw new UncheckedIOException(error);
        }
    }

    static Board control(String folder) {
        return new Board(folder, "control");
    }

    static Board of(String folder, TopologyContext context) {
        return new Board(folder, context.getThisComponentId() + "-" + context.getThisTaskId());
    }

    long get(int place) {
        return (long) NUMBER.getOpaque(numbers, Long.BYTES * place);
    }

    void add(int place, long more) {
        NUMBER.setOpaque(numbers, Long.BYTES * place, get(place) + more);
    }

    /** Counts a latency in its bucket: 32 for each doubling. */
    void record(long latencyNs) {
        long us = Math.max(latencyNs, 0) / 1000;
        int shift = Math.max(0, 58 - Long.numberOfLeadingZeros(us));
        add(LATENCIES + (int) Math.min(32L * shift + (us >> shift), BUCKETS - 1), 1);
    }
}
