package iotcloud.storm;

import java.util.AbstractList;
import java.util.ArrayList;
import java.util.Collections;
import java.util.HashMap;
import java.util.List;
import java.util.Map;
import java.util.concurrent.ScheduledFuture;
import org.apache.storm.Config;
import org.apache.storm.Constants;
import org.apache.storm.generated.GlobalStreamId;
import org.apache.storm.task.OutputCollector;
import org.apache.storm.task.TopologyContext;
import org.apache.storm.topology.IRichBolt;
import org.apache.storm.tuple.Tuple;
import org.apache.storm.utils.TupleUtils;

/**
 * A bolt of C++. Storm's executor, the thread of ticks and the thread of answers call it, each under its monitor, in which
 * it alone emits and answers. A bolt that keeps only the newest tuples of an input runs on a thread of its own instead.
 */
public class CppBolt extends CppComponent implements IRichBolt {
  private static final long serialVersionUID = 1;
  private transient OutputCollector collector;
  private transient NativeTask task;
  private transient Slots slots;
  private transient boolean flushes;
  private transient Map<Integer, List<Source>> sources;
  private transient boolean oneInput;
  private transient ScheduledFuture<?> ticks;
  private transient Thread keeper;
  private transient boolean closed;

  /** The component of the topology's file whose id is this component's. */
  public CppBolt(String file) {
    super(file);
  }

  /** A class of a component library, for Flux and Java. */
  public CppBolt(String library, String className) {
    this(library, className, Collections.emptyMap());
  }

  /** The same; `conf` has texts, numbers and booleans. */
  public CppBolt(String library, String className, Map<String, ?> conf) {
    super("bolt", library, className, conf);
  }

  /** A stream that feeds the bolt. */
  private static final class Source {
    final String stream;
    final int input;

    Source(String stream, int input) {
      this.stream = stream;
      this.input = input;
    }
  }

  @Override
  public synchronized void prepare(Map<String, Object> conf, TopologyContext context, OutputCollector out) {
    collector = out;
    slots = new Slots();
    sources = sources(context);
    oneInput = Description.inputs(context).size() == 1;
    Object batch = conf.get(Config.TOPOLOGY_PRODUCER_BATCH_SIZE);
    flushes = batch instanceof Number && ((Number) batch).intValue() > 1;
    try {
      Native.load(Description.folder(context));
      task = new NativeTask(Description.of(origin, context),
          Description.outputs(context), new BoltCollector());
      if (Native.isSpout(task.handle)) {
        throw new IllegalArgumentException(context.getThisComponentId() + " is a spout in C++, not a bolt");
      }
      Egress.add(Native.answering(task.handle), this::applyAnswers);
      task.apply(Native.open(task.handle));
    } catch (RuntimeException | UnsatisfiedLinkError error) {
      collector.reportError(error);
      throw error;
    }
    if (Native.keeps(task.handle)) {
      keeper = new Thread(this::runKept, context.getThisComponentId() + "-" + context.getThisTaskId() + "-kept");
      keeper.setDaemon(true);
      keeper.start();
    }
    long micros = Native.ownTickMicros(task.handle);
    if (micros > 0) {
      ticks = Timers.every(micros, this::tick);
    }
  }

  private static Map<Integer, List<Source>> sources(TopologyContext context) {
    Map<Integer, List<Source>> sources = new HashMap<>();
    List<GlobalStreamId> inputs = Description.inputs(context);
    for (int i = 0; i < inputs.size(); i++) {
      Source source = new Source(inputs.get(i).get_streamId(), i);
      for (int from : context.getComponentTasks(inputs.get(i).get_componentId())) {
        sources.computeIfAbsent(from, id -> new ArrayList<>()).add(source);
      }
    }
    return sources;
  }

  @Override
  public void execute(Tuple tuple) {
    // The stream is at hand; the component has to be looked up.
    if (Constants.SYSTEM_TICK_STREAM_ID.equals(tuple.getSourceStreamId()) && TupleUtils.isTick(tuple)) {
      tick();
      return;
    }
    int slot;
    int size;
    byte[][] arrays;
    synchronized (this) {
      try {
        size = task.input.write(tuple.getValues());
      } catch (ValueWriter.NoValue error) {
        String source = tuple.getSourceComponent() + "/" + tuple.getSourceStreamId();
        collector.reportError(new ComponentError(error.of(source, tuple.getFields().get(error.place()))));
        collector.fail(tuple);
        return;
      }
      arrays = task.input.arrays();
      slot = slots.put(tuple);
      if (keeper == null) {
        task.applyHere(Native.execute(task.handle, slot, inputOf(tuple), tuple.getSourceTask(), size, arrays));
        return;
      }
    }
    // Not in the monitor: it waits while too many tuples wait, and the keeper needs the monitor.
    int replaced = Native.keep(task.handle, slot, inputOf(tuple), tuple.getSourceTask(), size, arrays);
    if (replaced >= 0) {
      synchronized (this) {
        collector.ack(slots.take(replaced));
      }
    }
  }

  /** The thread that lets a bolt execute the tuples that it kept. */
  private void runKept() {
    for (int size = Native.runNext(task.handle); size >= 0; size = Native.runNext(task.handle)) {
      synchronized (this) {
        task.apply(size);
        flush();
      }
    }
  }

  private int inputOf(Tuple tuple) {
    if (oneInput) {
      return 0;
    }
    List<Source> streams = sources.get(tuple.getSourceTask());
    if (streams.size() > 1) {
      for (Source source : streams) {
        if (source.stream.equals(tuple.getSourceStreamId())) {
          return source.input;
        }
      }
    }
    return streams.get(0).input;
  }

  private synchronized void tick() {
    if (closed) {
      return;
    }
    if (keeper != null) {
      Native.requestTick(task.handle);
      return;
    }
    task.apply(Native.tick(task.handle));
    flush();
  }

  private synchronized void applyAnswers() {
    if (closed) {
      return;
    }
    task.apply(Native.takeAnswers(task.handle));
    flush();
  }

  /** What other threads than the executor's send would wait in their batch. */
  private void flush() {
    if (flushes) {
      collector.flush();
    }
  }

  @Override
  public void cleanup() {
    if (ticks != null) {
      ticks.cancel(false);
    }
    if (keeper != null) {
      Native.endKeeping(task.handle);
      try {
        keeper.join();
      } catch (InterruptedException interrupted) {
        Thread.currentThread().interrupt();
        return;
      }
    }
    synchronized (this) {
      closed = true;
      task.apply(Native.close(task.handle));
    }
  }

  /** Applies the component's commands. */
  private final class BoltCollector implements NativeTask.Collector {
    @Override
    public Object monitor() {
      return CppBolt.this;
    }

    @Override
    public void emit(String stream, int to, int[] anchors, int count, List<Object> values) {
      if (count == 1) {
        emit(stream, to, slots.get(anchors[0]), values);
      } else if (count > 1) {
        emit(stream, to, new Anchors(anchors, count), values);
      } else if (to < 0) {
        collector.emit(stream, values);
      } else {
        collector.emitDirect(to, stream, values);
      }
    }

    private void emit(String stream, int to, Tuple anchor, List<Object> values) {
      if (to < 0) {
        collector.emit(stream, anchor, values);
      } else {
        collector.emitDirect(to, stream, anchor, values);
      }
    }

    private void emit(String stream, int to, List<Tuple> anchors, List<Object> values) {
      if (to < 0) {
        collector.emit(stream, anchors, values);
      } else {
        collector.emitDirect(to, stream, anchors, values);
      }
    }

    @Override
    public void emit(String stream, int to, Long id, List<Object> values) {
      throw new IllegalStateException("a bolt emits as a spout");
    }

    @Override
    public Object kept(int slot, int place) {
      return slots.get(slot).getValue(place);
    }

    @Override
    public void answer(byte command, int slot) {
      if (NativeTask.isReset(command)) {
        collector.resetTimeout(slots.get(slot));
        return;
      }
      Tuple tuple = slots.take(slot);
      if (NativeTask.isAck(command)) {
        collector.ack(tuple);
      } else if (NativeTask.isFail(command)) {
        collector.fail(tuple);
      }
    }

    @Override
    public void reportError(Throwable error) {
      collector.reportError(error);
    }
  }

  /** The tuples in some slots, during one emit. */
  private final class Anchors extends AbstractList<Tuple> {
    private final int[] anchors;
    private final int count;

    Anchors(int[] anchors, int count) {
      this.anchors = anchors;
      this.count = count;
    }

    @Override
    public Tuple get(int i) {
      return slots.get(anchors[i]);
    }

    @Override
    public int size() {
      return count;
    }
  }
}
